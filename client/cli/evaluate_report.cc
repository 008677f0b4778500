#include "client/cli/evaluate_report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "absl/strings/str_format.h"
#include "client/cli/plot_file.h"
#include "client/lab/distinct.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

using Summaries = std::vector<GroupSummary>;

std::string EnvironmentText(const std::optional<Environment>& environment) {
  return environment ? std::string(EnvironmentName(*environment)) : "all";
}

std::string CountText(const std::optional<int64_t>& count) {
  return count ? absl::StrCat(*count) : "all";
}

std::string IcpText(core::IcpMethod icp) {
  return std::string(IcpMethodName(icp));
}

std::vector<std::string> Methods(const Summaries& summaries) {
  return DistinctValues<std::string>(summaries,
                                     [](const auto& s) { return s.method; });
}
std::vector<core::IcpMethod> IcpMethods(const Summaries& summaries) {
  return DistinctValues<core::IcpMethod>(summaries,
                                         [](const auto& s) { return s.icp; });
}
std::vector<std::optional<Environment>> Environments(
    const Summaries& summaries) {
  return DistinctValues<std::optional<Environment>>(
      summaries, [](const auto& s) { return s.environment; });
}

const GroupSummary* Find(const Summaries& summaries,
                         const std::optional<Environment>& environment,
                         const std::optional<int64_t>& count,
                         core::IcpMethod icp, const std::string& method) {
  const auto found = std::find_if(
      summaries.begin(), summaries.end(), [&](const GroupSummary& s) {
        return s.environment == environment && s.count == count &&
               s.icp == icp && s.method == method;
      });
  return found == summaries.end() ? nullptr : &*found;
}

// CSV and JSON ----------------------------------------------------------------

constexpr std::array<std::string_view, 6> kErrorFields = {
    "median",         "low",           "high", "lower_quartile",
    "upper_quartile", "ties_with_best"};

std::string ErrorCells(const ErrorSummary& e) {
  return absl::StrFormat(",%.9g,%.9g,%.9g,%.9g,%.9g,%d", e.median, e.low,
                         e.high, e.lower_quartile, e.upper_quartile,
                         e.ties_with_best ? 1 : 0);
}

std::string SummaryCsv(const Summaries& summaries) {
  std::string text =
      "environment,count,method,icp,pairs,trials,failures,converged,"
      "degenerate";
  for (const char* error : {"translation_m", "rotation_deg"}) {
    for (const std::string_view field : kErrorFields) {
      absl::StrAppend(&text, ",", error, "_", ToAbsl(field));
    }
  }
  text += ",points,sample_s,icp_s\n";
  for (const GroupSummary& s : summaries) {
    absl::StrAppendFormat(
        &text, "%s,%s,%s,%s,%d,%d,%d,%d,%d", EnvironmentText(s.environment),
        CountText(s.count), s.method, IcpText(s.icp), s.pair_count,
        s.trial_count, s.failure_count, s.converged_count, s.degenerate_count);
    text += ErrorCells(s.translation_m) + ErrorCells(s.rotation_deg);
    absl::StrAppendFormat(&text, ",%g,%.6f,%.6f\n", s.points, s.sample_s,
                          s.icp_s);
  }
  return text;
}

Json ErrorJson(const ErrorSummary& e) {
  return {{"median", NumberJson(e.median)},
          {"interval_95", {NumberJson(e.low), NumberJson(e.high)}},
          {"quartiles",
           {NumberJson(e.lower_quartile), NumberJson(e.upper_quartile)}},
          {"ties_with_best", e.ties_with_best}};
}

Json SummaryJson(const Summaries& summaries, const NeededTable& needed,
                 const Json& settings) {
  Json groups = Json::array();
  for (const GroupSummary& s : summaries) {
    groups.push_back({{"environment", EnvironmentText(s.environment)},
                      {"count", s.count ? Json(*s.count) : Json("all")},
                      {"method", s.method},
                      {"icp", IcpText(s.icp)},
                      {"pairs", s.pair_count},
                      {"trials", s.trial_count},
                      {"failures", s.failure_count},
                      {"converged", s.converged_count},
                      {"degenerate", s.degenerate_count},
                      {"translation_m", ErrorJson(s.translation_m)},
                      {"rotation_deg", ErrorJson(s.rotation_deg)},
                      {"points", s.points},
                      {"sample_s", s.sample_s},
                      {"icp_s", s.icp_s}});
  }
  return {{"settings", settings},
          {"failure",
           {{"translation_m", kFailedTranslation},
            {"rotation_deg", kFailedRotationDeg}}},
          {"needed_points", NeededJson(needed)},
          {"summaries", std::move(groups)}};
}

// Figures ---------------------------------------------------------------------

constexpr std::array<std::string_view, 13> kColors = {
    "#8a8d94", "#e69f00", "#009e73", "#56b4e9", "#000000", "#cc79a7", "#a6761d",
    "#d55e00", "#0072b2", "#f4a582", "#92c5de", "#7b3294", "#e7298a"};

/// What a panel shows of a method at a count: a value and how far it reaches.
struct Mark {
  double value = 0;
  double low = 0;
  double high = 0;
};

/// How the lines of method number `m` look.
std::string LineStyle(size_t m) {
  return absl::StrFormat(
      "pointtype 7 pointsize 0.4 linewidth 1.5 linecolor \"%s\"",
      std::string(kColors[m % kColors.size()]));
}

/// One diagram, a line a method.
template <typename MarkOf>
std::string PanelScript(const Summaries& summaries, const std::string& title,
                        const std::optional<Environment>& environment,
                        core::IcpMethod icp, const MarkOf& mark_of) {
  std::string script = absl::StrFormat("set title \"%s\"\n", title);
  std::string plot;
  const std::vector<std::string> methods = Methods(summaries);
  for (size_t m = 0; m < methods.size(); ++m) {
    absl::StrAppendFormat(&script, "$method%d << END\n", m);
    // Beside each other, or their bars would hide one another.
    const double shift = std::pow(
        1.02, static_cast<double>(m) - static_cast<double>(methods.size()) / 2);
    for (const GroupSummary& s : summaries) {
      if (s.environment != environment || !s.count || s.icp != icp ||
          s.method != methods[m]) {
        continue;
      }
      const Mark mark = mark_of(s);
      // A logarithmic axis has neither zero nor infinity.
      if (!(mark.low > 0 && std::isfinite(mark.high))) continue;
      absl::StrAppendFormat(&script, "%g %g %g %g\n",
                            static_cast<double>(*s.count) * shift, mark.value,
                            mark.low, mark.high);
    }
    script += "END\n";
    absl::StrAppendFormat(&plot,
                          "%s $method%d using 1:2:3:4 with yerrorlines %s",
                          m == 0 ? "plot" : ",", m, LineStyle(m));
  }
  return script + plot + "\n";
}

/// In place of a diagram, the names of the lines of all.
std::string LegendScript(const Summaries& summaries) {
  std::string script =
      "unset border\nunset tics\nunset xlabel\nunset ylabel\nunset title\n"
      "unset logscale\nset key center center reverse Left samplen 2\n"
      "set xrange [0:1]\nset yrange [0:1]\n";
  const std::vector<std::string> methods = Methods(summaries);
  for (size_t m = 0; m < methods.size(); ++m) {
    absl::StrAppendFormat(&script, "%s NaN with linespoints %s title \"%s\"",
                          m == 0 ? "plot" : ",", LineStyle(m), methods[m]);
  }
  return script + "\n";
}

/// Of a figure of so many diagrams and a legend.
std::string FigureHead(const Summaries& summaries, const std::string& title,
                       size_t panel_count, const std::string& y_label) {
  int64_t low = std::numeric_limits<int64_t>::max();
  int64_t high = 0;
  for (const GroupSummary& s : summaries) {
    if (!s.count) continue;
    low = std::min(low, *s.count);
    high = std::max(high, *s.count);
  }
  return absl::StrFormat(
      "set encoding utf8\nset multiplot layout 1,%d title \"%s\"\n"
      "set key off\nset border 3\nset tics nomirror\n"
      "set grid ytics linecolor \"#dddddd\"\nset logscale xy\n"
      "set xrange [%g:%g]\nset format x \"%%.0s%%c\"\n"
      "set xlabel \"points of a sample\"\nset ylabel \"%s\"\n",
      panel_count + 1, title, static_cast<double>(low) / 1.3,
      static_cast<double>(high) * 1.3, y_label);
}

PlotSize FigureSize(size_t panel_count) {
  constexpr int kPanelWidth = 330;
  constexpr int kPanelHeight = 440;
  return {kPanelWidth * static_cast<int>(panel_count + 1), kPanelHeight};
}

/// A figure: its name and its SVG.
using Figure = std::pair<std::string, std::string>;

absl::StatusOr<Figure> DrawErrors(const Summaries& summaries,
                                  core::IcpMethod icp, bool is_translation,
                                  const std::filesystem::path& folder) {
  const auto environments = Environments(summaries);
  const std::string what = is_translation ? "translation" : "rotation";
  std::string script =
      FigureHead(summaries,
                 absl::StrFormat("Error of %s, median and quartiles, ICP %s",
                                 what, IcpText(icp)),
                 environments.size(), is_translation ? "mm" : "degrees");
  for (const auto& environment : environments) {
    script +=
        PanelScript(summaries, EnvironmentText(environment), environment, icp,
                    [&](const GroupSummary& s) {
                      const ErrorSummary& e =
                          is_translation ? s.translation_m : s.rotation_deg;
                      const double unit = is_translation ? 1000 : 1;
                      return Mark{unit * e.median, unit * e.lower_quartile,
                                  unit * e.upper_quartile};
                    });
  }
  script += LegendScript(summaries);
  const std::string name = what + "_" + IcpText(icp);
  MAPSIEVE_ASSIGN_OR_RETURN(
      std::string svg,
      WritePlot(folder, name, script, FigureSize(environments.size())));
  return Figure(name, std::move(svg));
}

absl::StatusOr<Figure> DrawTimes(const Summaries& summaries,
                                 const std::filesystem::path& folder) {
  const std::vector<core::IcpMethod> icps = IcpMethods(summaries);
  std::string script = FigureHead(summaries, "Median time on one thread",
                                  1 + icps.size(), "seconds");
  script += PanelScript(summaries, "sampling both scans", std::nullopt,
                        icps.front(), [](const GroupSummary& s) {
                          return Mark{s.sample_s, s.sample_s, s.sample_s};
                        });
  for (const core::IcpMethod icp : icps) {
    script += PanelScript(summaries, "ICP " + IcpText(icp), std::nullopt, icp,
                          [](const GroupSummary& s) {
                            return Mark{s.icp_s, s.icp_s, s.icp_s};
                          });
  }
  script += LegendScript(summaries);
  MAPSIEVE_ASSIGN_OR_RETURN(
      std::string svg,
      WritePlot(folder, "times", script, FigureSize(1 + icps.size())));
  return Figure("times", std::move(svg));
}

// HTML ------------------------------------------------------------------------

constexpr char kHtmlHead[] =
    "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n"
    "<title>Registration by sampler</title>\n<style>\n"
    "body{font:15px/1.45 'DejaVu Sans',sans-serif;margin:2em auto;"
    "max-width:1500px;padding:0 1em}\n"
    "table{border-collapse:collapse;margin:1em 0}\n"
    "td,th{padding:.25em .7em;text-align:right;border-bottom:1px solid #ddd}\n"
    "td:first-child,th:first-child{text-align:left}\n"
    "small{color:#666}\nsvg{max-width:100%;height:auto}\n</style></head>"
    "<body>\n<h1>Registration by sampler</h1>\n";

/// `text` as text of HTML.
std::string Escaped(std::string_view text) {
  std::string html;
  for (const char c : text) {
    switch (c) {
      case '<':
        html += "&lt;";
        break;
      case '>':
        html += "&gt;";
        break;
      case '&':
        html += "&amp;";
        break;
      default:
        html += c;
    }
  }
  return html;
}

std::string ErrorText(const ErrorSummary& e, double unit, const char* name) {
  const std::string median = FewDigits(unit * e.median);
  return absl::StrFormat("%s%s%s %s <small>[%s–%s]</small>",
                         e.ties_with_best ? "<b>" : "", median,
                         e.ties_with_best ? "</b>" : "", name,
                         FewDigits(unit * e.low), FewDigits(unit * e.high));
}

std::string ErrorTable(const Summaries& summaries, core::IcpMethod icp) {
  std::string html = absl::StrFormat(
      "<h2>ICP %s</h2>\n<table><tr><th>method</th>", IcpText(icp));
  const auto environments = Environments(summaries);
  for (const auto& environment : environments) {
    absl::StrAppend(&html, "<th>", EnvironmentText(environment), "</th>");
  }
  html +=
      "<th>failures</th><th>degenerate</th><th>sampling, s</th><th>ICP, "
      "s</th></tr>\n";
  for (const std::string& method : Methods(summaries)) {
    absl::StrAppend(&html, "<tr><td>", method, "</td>");
    for (const auto& environment : environments) {
      const GroupSummary* s =
          Find(summaries, environment, std::nullopt, icp, method);
      html += "<td>";
      if (s != nullptr) {
        html += ErrorText(s->translation_m, 1000, "mm") + "<br>" +
                ErrorText(s->rotation_deg, 1, "°");
      }
      html += "</td>";
    }
    const GroupSummary* all =
        Find(summaries, std::nullopt, std::nullopt, icp, method);
    if (all != nullptr) {
      absl::StrAppendFormat(
          &html, "<td>%d of %d</td><td>%d</td><td>%.3f</td><td>%.3f</td>",
          all->failure_count, all->trial_count, all->degenerate_count,
          all->sample_s, all->icp_s);
    }
    html += "</tr>\n";
  }
  return html + "</table>\n";
}

std::string ReportHtml(const Summaries& summaries, const NeededTable& needed,
                       const Json& settings,
                       const std::vector<Figure>& figures) {
  std::string html = kHtmlHead + NeededHtml(needed);
  html += absl::StrFormat(
      "<p>Median errors of registrations at all counts of points, by the "
      "environment of the pair; in brackets their 95 %% bootstrap interval "
      "over pairs. Bold: the lowest median and those that the pairs do not "
      "tell apart from it. A failure is farther than %g m or %g° from the "
      "truth, or has no result. Degenerate: the pairs leave a direction of "
      "motion free, in which the pose stays as it was. Times are medians on "
      "one thread.</p>\n",
      kFailedTranslation, kFailedRotationDeg);
  for (const core::IcpMethod icp : IcpMethods(summaries)) {
    html += ErrorTable(summaries, icp);
  }
  html += "<h2>Figures</h2>\n";
  for (const Figure& figure : figures) {
    // What comes before the picture is the head of a file.
    const std::string& svg = figure.second;
    html += "<figure>" + svg.substr(svg.find("<svg")) + "</figure>\n";
  }
  return html + "<h2>Settings</h2>\n<pre>" + Escaped(settings.dump(2)) +
         "</pre>\n</body></html>\n";
}

}  // namespace

absl::Status WriteEvaluation(const std::vector<GroupSummary>& summaries,
                             const NeededTable& needed, const Json& settings,
                             const std::filesystem::path& folder) {
  MAPSIEVE_RETURN_IF_ERROR(
      WriteFile(folder / "summary.csv", SummaryCsv(summaries)));
  MAPSIEVE_RETURN_IF_ERROR(
      WriteFile(folder / "summary.json",
                SummaryJson(summaries, needed, settings).dump(2) + "\n"));
  MAPSIEVE_RETURN_IF_ERROR(
      WriteFile(folder / "needed_points.csv", NeededCsv(needed)));
  std::vector<Figure> figures;
  for (const core::IcpMethod icp : IcpMethods(summaries)) {
    for (const bool is_translation : {true, false}) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          Figure figure, DrawErrors(summaries, icp, is_translation, folder));
      figures.push_back(std::move(figure));
    }
  }
  MAPSIEVE_ASSIGN_OR_RETURN(Figure times, DrawTimes(summaries, folder));
  figures.push_back(std::move(times));
  return WriteFile(folder / "report.html",
                   ReportHtml(summaries, needed, settings, figures));
}

}  // namespace mapsieve::client
