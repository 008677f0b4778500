#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "core/cloud/packed_columns.h"
#include "core/cloud/point_cloud.h"
#include "core/cloud/row_runs.h"
#include "core/geometry/octahedral.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::core {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::AllOf;
using ::testing::HasSubstr;

TEST(ScalarType, NamesCppTypes) {
  EXPECT_EQ(ScalarTypeOf<int8_t>(), ScalarType::kInt8);
  EXPECT_EQ(ScalarTypeOf<uint64_t>(), ScalarType::kUint64);
  EXPECT_EQ(ScalarTypeOf<float>(), ScalarType::kFloat32);
  EXPECT_EQ(ScalarTypeOf<double>(), ScalarType::kFloat64);
  for (int i = 1; i <= 10; ++i) {
    const auto type = static_cast<ScalarType>(i);
    VisitScalarType(type, [&](auto zero) {
      EXPECT_EQ(ScalarTypeOf<decltype(zero)>(), type);
      EXPECT_EQ(sizeof(zero), ScalarSize(type));
    });
  }
}

TEST(Column, KeepsMissingApartFromZero) {
  Column a({"time", ScalarType::kFloat64});
  a.Append(0.0);
  a.AppendMissing(1);
  a.Append(2.5);
  EXPECT_FALSE(a.IsMissing(0));
  EXPECT_TRUE(a.IsMissing(1));
  EXPECT_EQ(a.GetAsDouble(2), 2.5);
  Column b({"time", ScalarType::kFloat64}, 1);
  b.AppendAll(a);
  EXPECT_EQ(b.size(), 4u);
  EXPECT_TRUE(b.IsMissing(2));
  const Column picked = b.Select(std::vector<uint32_t>{3, 2});
  EXPECT_EQ(picked.Get<double>(0), 2.5);
  EXPECT_TRUE(picked.IsMissing(1));
  EXPECT_FALSE(b.Select(std::vector<uint32_t>{0, 3}).has_missing());
}

TEST(ColumnSet, AppendFillsAbsentColumnsWithMissing) {
  ColumnSet first;
  Column a({"a", ScalarType::kInt32});
  a.Append(int32_t{7});
  MAPSIEVE_ASSERT_OK(first.Add(a));
  ColumnSet second;
  Column b({"b", ScalarType::kUint8});
  b.Append(uint8_t{9});
  MAPSIEVE_ASSERT_OK(second.Add(b));
  MAPSIEVE_ASSERT_OK(first.AppendAll(1, second, 1));
  EXPECT_TRUE(first.Find("a")->IsMissing(1));
  EXPECT_TRUE(first.Find("b")->IsMissing(0));
  EXPECT_EQ(first.Find("b")->Get<uint8_t>(1), 9);
}

TEST(ColumnSet, RefusesTheSameNameWithAnotherType) {
  ColumnSet first;
  MAPSIEVE_ASSERT_OK(first.Add(Column({"a", ScalarType::kInt32}, 1)));
  EXPECT_THAT(first.Add(Column({"a", ScalarType::kInt32}, 1)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("\"a\"")));
  ColumnSet second;
  MAPSIEVE_ASSERT_OK(second.Add(Column({"a", ScalarType::kFloat32}, 1)));
  const ColumnSet before = first;
  EXPECT_THAT(first.AppendAll(1, second, 1),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("int32"), HasSubstr("float32"))));
  EXPECT_EQ(first, before);
}

TEST(SelectRuns, IsSelectOfTheirRows) {
  LatticeCloud cloud;
  Column bytes({"bytes", ScalarType::kUint8});
  Column times({"times", ScalarType::kFloat64});
  for (int i = 0; i < 100; ++i) {
    cloud.positions.push_back({i, 2 * i, -i});
    bytes.Append(static_cast<uint8_t>(i));
    times.Append(0.5 * i);
  }
  times.SetMissing(41);
  MAPSIEVE_ASSERT_OK(cloud.attributes.Add(bytes));
  MAPSIEVE_ASSERT_OK(cloud.attributes.Add(times));
  const auto expect_same = [&](const std::vector<RowRun>& runs) {
    std::vector<uint32_t> rows;
    for (const RowRun& run : runs) {
      for (uint32_t i = 0; i < run.count; ++i) rows.push_back(run.begin + i);
    }
    const LatticeCloud selected = SelectRuns(cloud, runs);
    const LatticeCloud expected = cloud.Select(rows);
    EXPECT_EQ(selected.positions, expected.positions);
    EXPECT_EQ(selected.attributes, expected.attributes);
  };
  expect_same({});
  expect_same({{0, 100}});
  expect_same({{40, 3}, {7, 1}, {99, 1}, {40, 2}});
  // None of them is missing: no column says so.
  expect_same({{42, 58}, {5, 0}, {0, 41}});
}

TEST(Quantize, RefusesAndCountsByReason) {
  PointCloud cloud;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  cloud.positions = {
      {1, 2, 3}, {nan, 0, 0}, {0, inf, 0}, {0, 0, 1e300}, {4, 5, 6}};
  Column id({"id", ScalarType::kUint8});
  for (uint8_t i = 0; i < 5; ++i) id.Append(i);
  MAPSIEVE_ASSERT_OK(cloud.attributes.Add(id));
  RefusedCounts refused;
  const LatticeCloud q = Quantize(cloud, Lattice(), refused);
  EXPECT_EQ(refused, (RefusedCounts{2, 1}));
  ASSERT_EQ(q.size(), 2u);
  EXPECT_EQ(q.positions[1], (LatticePoint{4000, 5000, 6000}));
  EXPECT_EQ(q.attributes.Find("id")->Get<uint8_t>(1), 4);
}

TEST(PackedColumns, StandForPlainOnes) {
  Column confidence({std::string(kPackedConfidence), ScalarType::kUint16}, 2);
  confidence.Set(0, uint16_t{65535});
  confidence.Set(1, uint16_t{0});
  Column normal({std::string(kPackedNormal), ScalarType::kUint32}, 2);
  const std::array<Vector3, 2> vectors = {{{0, 0, -1}, {0.6, 0, 0.8}}};
  for (size_t i = 0; i < vectors.size(); ++i) {
    normal.Set(i, EncodeOctahedral(vectors[i]));
  }
  Column other({"spdf.normal", ScalarType::kUint8}, 2);
  std::vector<Column> plain;
  for (const Column& column : {confidence, normal, other}) {
    std::vector<Column> alone;
    Unpack(column, alone);
    std::vector<ColumnSpec> specs;
    for (const Column& one : alone) specs.push_back(one.spec());
    EXPECT_EQ(specs, UnpackedSpecs(column.spec()));
    Unpack(column, plain);
  }
  ASSERT_EQ(plain.size(), 5u);
  EXPECT_EQ(plain[0].spec(), (ColumnSpec{"confidence", ScalarType::kFloat32}));
  EXPECT_EQ(plain[0].Get<float>(0), 1);
  EXPECT_EQ(plain[0].Get<float>(1), 0);
  for (size_t axis = 0; axis < 3; ++axis) {
    EXPECT_EQ(plain[1 + axis].name(), std::string("n") + "xyz"[axis]);
    for (size_t i = 0; i < vectors.size(); ++i) {
      EXPECT_NEAR(plain[1 + axis].Get<float>(i), vectors[i][axis], 1e-3);
    }
  }
  // The name alone does not make a packed column.
  EXPECT_EQ(plain[4].spec(), other.spec());
}

}  // namespace
}  // namespace mapsieve::core
