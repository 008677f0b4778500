#ifndef MAPSIEVE_TESTS_TESTING_PRECOMPILED_H_
#define MAPSIEVE_TESTS_TESTING_PRECOMPILED_H_

// What nearly every test includes and takes long to parse; compiled once for
// all test programs.

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/types/span.h"
#include "core/base/executor.h"
#include "core/base/mutex.h"
#include "core/base/status.h"
#include "core/cloud/point_cloud.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

#endif  // MAPSIEVE_TESTS_TESTING_PRECOMPILED_H_
