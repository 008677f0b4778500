#ifndef MAPSIEVE_CLIENT_LAB_DISTINCT_H_
#define MAPSIEVE_CLIENT_LAB_DISTINCT_H_

#include <algorithm>
#include <vector>

namespace mapsieve::client {

/// get(item) of all items without repeats, in the order of their first coming.
template <typename Value, typename Items, typename Get>
std::vector<Value> DistinctValues(const Items& items, const Get& get) {
  std::vector<Value> values;
  for (const auto& item : items) {
    const Value value = get(item);
    if (std::find(values.begin(), values.end(), value) == values.end()) {
      values.push_back(value);
    }
  }
  return values;
}

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_DISTINCT_H_
