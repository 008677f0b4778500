// A target that owns a precompiled header has at least one source file.
#include "tests/testing/precompiled.h"
