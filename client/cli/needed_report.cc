#include "client/cli/needed_report.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

constexpr size_t kColumnCount = 8;
using Cells = std::array<std::string, kColumnCount>;

constexpr std::array<std::string_view, kColumnCount> kHead = {
    "method",  "ICP",      "points",      "mm",
    "degrees", "failures", "sampling, s", "ICP, s"};

constexpr char kNote[] =
    "Not reached: in brackets the count with the lowest median, whose figures "
    "follow. Errors and times are medians, the latter on one thread.";

std::string IcpText(const NeededPoints& needed) {
  return std::string(IcpMethodName(needed.at.icp));
}

Cells CellsOf(const NeededPoints& needed) {
  const GroupSummary& at = needed.at;
  const int64_t count = at.count.value();
  return {at.method,
          IcpText(needed),
          needed.is_reached ? absl::StrCat(count)
                            : absl::StrFormat("not reached (%d)", count),
          FewDigits(1000 * at.translation_m.median),
          FewDigits(at.rotation_deg.median),
          absl::StrFormat("%d of %d", at.failure_count, at.trial_count),
          absl::StrFormat("%.3f", at.sample_s),
          absl::StrFormat("%.3f", at.icp_s)};
}

/// What the rows' registrations do not hold, or nothing.
std::string DegenerateNote(const NeededTable& table) {
  int64_t degenerate_count = 0;
  int64_t trial_count = 0;
  for (const NeededPoints& needed : table.rows) {
    degenerate_count += needed.at.degenerate_count;
    trial_count += needed.at.trial_count;
  }
  if (degenerate_count == 0) return "";
  return absl::StrFormat(
      "In %d of %d registrations the points slide on their surfaces, as on a "
      "plane or in a corridor: in a direction that nothing holds, the pose "
      "stays as it starts.",
      degenerate_count, trial_count);
}

/// In characters, some of which are several bytes.
size_t Width(std::string_view text) {
  return static_cast<size_t>(std::count_if(
      text.begin(), text.end(),
      [](char c) { return (static_cast<unsigned char>(c) & 0xC0) != 0x80; }));
}

}  // namespace

std::string NeededSentence(const NeededTable& table) {
  const NeededPoints& best = table.rows.front();
  const std::string target = absl::StrFormat("a median error of %s mm",
                                             FewDigits(1000 * table.target_m));
  if (!best.is_reached) {
    return absl::StrFormat("No method reaches %s at these counts", target);
  }
  return absl::StrFormat("Fewest points for %s: %d by %s, with ICP %s", target,
                         best.at.count.value(), best.at.method, IcpText(best));
}

std::string NeededText(const NeededTable& table) {
  std::vector<Cells> lines(1);
  std::copy(kHead.begin(), kHead.end(), lines[0].begin());
  bool all_reached = true;
  for (const NeededPoints& needed : table.rows) {
    lines.push_back(CellsOf(needed));
    all_reached = all_reached && needed.is_reached;
  }
  std::array<size_t, kColumnCount> widths{};
  for (const Cells& cells : lines) {
    for (size_t i = 0; i < kColumnCount; ++i) {
      widths[i] = std::max(widths[i], Width(cells[i]));
    }
  }
  std::string text = NeededSentence(table) + ".\n\n";
  for (const Cells& cells : lines) {
    for (size_t i = 0; i < kColumnCount; ++i) {
      const std::string pad(widths[i] - Width(cells[i]), ' ');
      const bool is_word = i < 2;
      absl::StrAppend(&text, i == 0 ? "" : "  ", is_word ? cells[i] : pad,
                      is_word ? pad : cells[i]);
    }
    text += "\n";
  }
  if (!all_reached) absl::StrAppend(&text, "\n", kNote, "\n");
  const std::string degenerate = DegenerateNote(table);
  if (!degenerate.empty()) absl::StrAppend(&text, "\n", degenerate, "\n");
  return text;
}

std::string NeededHtml(const NeededTable& table) {
  std::string html =
      absl::StrFormat("<h2>Points needed</h2>\n<p>%s. %s %s</p>\n<table><tr>",
                      NeededSentence(table), kNote, DegenerateNote(table));
  for (const std::string_view name : kHead) {
    absl::StrAppend(&html, "<th>", ToAbsl(name), "</th>");
  }
  html += "</tr>\n";
  for (const NeededPoints& needed : table.rows) {
    html += "<tr>";
    for (const std::string& cell : CellsOf(needed)) {
      absl::StrAppend(&html, "<td>", cell, "</td>");
    }
    html += "</tr>\n";
  }
  return html + "</table>\n";
}

std::string NeededCsv(const NeededTable& table) {
  std::string text =
      "method,icp,target_m,reached,count,translation_m,rotation_deg,failures,"
      "degenerate,trials,sample_s,icp_s\n";
  for (const NeededPoints& needed : table.rows) {
    const GroupSummary& at = needed.at;
    absl::StrAppendFormat(
        &text, "%s,%s,%g,%d,%d,%.9g,%.9g,%d,%d,%d,%.6f,%.6f\n", at.method,
        IcpText(needed), table.target_m, needed.is_reached ? 1 : 0,
        at.count.value(), at.translation_m.median, at.rotation_deg.median,
        at.failure_count, at.degenerate_count, at.trial_count, at.sample_s,
        at.icp_s);
  }
  return text;
}

Json NeededJson(const NeededTable& table) {
  Json rows = Json::array();
  for (const NeededPoints& needed : table.rows) {
    const GroupSummary& at = needed.at;
    rows.push_back({{"method", at.method},
                    {"icp", IcpText(needed)},
                    {"reached", needed.is_reached},
                    {"count", at.count.value()},
                    {"translation_m", NumberJson(at.translation_m.median)},
                    {"rotation_deg", NumberJson(at.rotation_deg.median)},
                    {"failures", at.failure_count},
                    {"degenerate", at.degenerate_count},
                    {"trials", at.trial_count},
                    {"sample_s", at.sample_s},
                    {"icp_s", at.icp_s}});
  }
  return rows;
}

}  // namespace mapsieve::client
