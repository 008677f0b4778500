#ifndef MAPSIEVE_TESTS_FORMATS_ATTRIBUTES_OF_H_
#define MAPSIEVE_TESTS_FORMATS_ATTRIBUTES_OF_H_

#include <string>

#include "core/cloud/point_cloud.h"
#include "gtest/gtest.h"

namespace mapsieve::client::testing {

/// The value of an attribute as double; a failure if there is no such.
inline double Value(const core::PointCloud& cloud, const std::string& name,
                    size_t row = 0) {
  const core::Column* column = cloud.attributes.Find(name);
  if (column == nullptr) {
    ADD_FAILURE() << "no attribute " << name;
    return 0;
  }
  return column->GetAsDouble(row);
}

/// The columns of `read` under the names of `written`, in its order; a failure
/// if one is lost.
inline core::ColumnSet Same(const core::PointCloud& written,
                            const core::PointCloud& read) {
  core::ColumnSet same;
  for (const core::Column& column : written.attributes.columns()) {
    const core::Column* found = read.attributes.Find(column.name());
    if (found == nullptr) {
      ADD_FAILURE() << "lost: " << column.name();
    } else {
      same.columns().push_back(*found);
    }
  }
  return same;
}

}  // namespace mapsieve::client::testing

#endif  // MAPSIEVE_TESTS_FORMATS_ATTRIBUTES_OF_H_
