#include "client/cli/sample_report.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/cli/output.h"
#include "client/cli/plot_file.h"
#include "client/cli/progress_bar.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

using core::DensityRule;
using core::Label;

size_t Index(Label label) { return static_cast<size_t>(label); }

std::string Name(Label label) { return std::string(core::LabelName(label)); }

std::string Name(DensityRule rule) {
  return std::string(core::DensityRuleName(rule));
}

// JSON ------------------------------------------------------------------------

/// A member for each geometric label.
template <typename MakeMember>
Json ByLabel(const MakeMember& make_member) {
  Json result;
  for (const Label label : kGeometricLabels) {
    result[Name(label)] = make_member(label);
  }
  return result;
}

Json OptionsJson(const core::SpdfOptions& options) {
  return {{"neighbors", options.neighbor_count},
          {"label_neighbors", options.LabelNeighborCount()},
          {"sigma", options.vote_scale_m2},
          {"rho", options.density_radius_m},
          {"reach", options.reach_m},
          {"rounds", options.max_round_count},
          {"seed", options.seed},
          {"outlier_share", options.outlier_share}};
}

Json DistributionJson(const Distribution& d) {
  return {{"count", d.count},
          {"mean", d.mean},
          {"p10", d.p10},
          {"median", d.median},
          {"p90", d.p90}};
}

Json SaliencyJson(const PerLabel<SaliencyHistogram>& histograms) {
  return ByLabel([&](Label label) {
    const SaliencyHistogram& histogram = histograms[Index(label)];
    return Json{{"all", histogram.all}, {"labeled", histogram.labeled}};
  });
}

Json ConfusionJson(const Confusion& confusion) {
  Json classes = Json::array();
  for (const ClassOutcome& of : confusion.classes) {
    Json one = {{"class", of.value}, {"name", of.name}};
    one.update(LabelCountsJson(of.kept));
    one["outlier"] = of.outlier_count;
    one["thinned"] = of.thinned_count;
    classes.push_back(std::move(one));
  }
  return {{"attribute", confusion.attribute}, {"classes", std::move(classes)}};
}

Json RuleJson(const FilterReport& report, const RuleReport& rule) {
  Json confusions = Json::array();
  for (const Confusion& confusion : rule.confusions) {
    confusions.push_back(ConfusionJson(confusion));
  }
  const Json density = ByLabel([&](Label label) {
    const LabelDensity& d = rule.density[Index(label)];
    return Json{
        {"survivors", d.survivor_count},
        {"below_target_in_input", d.sparse_count},
        {"target", report.target_density[Index(label)]},
        {"reached", report.target_density[Index(label)] * d.reached.mean},
        {"input_over_target", DistributionJson(d.input)},
        {"reached_over_target", DistributionJson(d.reached)},
        {"reached_over_target_histogram", d.reached_histogram}};
  });
  return {{"rule", Name(rule.rule)},
          {"points_in", report.point_count},
          {"points_after_rounds", rule.survivor_count},
          {"points_after_outliers", rule.kept_count},
          {"label_counts_after_rounds",
           LabelCountsJson(rule.survivor_label_counts)},
          {"label_counts", LabelCountsJson(rule.kept_label_counts)},
          {"rounds", rule.round_count},
          {"filter_s", rule.filter_s},
          {"density", density},
          {"saliency_histograms", SaliencyJson(rule.saliency)},
          {"known_classes", std::move(confusions)}};
}

Json ReportJson(const FilterReport& report) {
  Json ratio_edges = Json::array();
  for (size_t bin = 0; bin <= RatioBins::kCount; ++bin) {
    ratio_edges.push_back(RatioBins::LowerEdge(bin));
  }
  Json rules = Json::array();
  for (const RuleReport& rule : report.rules) {
    rules.push_back(RuleJson(report, rule));
  }
  return {{"options", OptionsJson(report.options)},
          {"step", report.step},
          {"points_in", report.point_count},
          {"ideal", ByLabel([&](Label label) {
             return Json{
                 {"dimension", LabelDimension(label)},
                 {"target_density", report.target_density[Index(label)]},
                 {"strength", report.expected_strength[Index(label)]},
                 {"saliency", report.expected_saliency[Index(label)]}};
           })},
          {"bins",
           {{"saliency_width", SaliencyBins::kWidth},
            {"ratio_edges", ratio_edges}}},
          {"before",
           {{"label_counts", LabelCountsJson(report.input_label_counts)},
            {"saliency_histograms", SaliencyJson(report.input_saliency)}}},
          {"rules", std::move(rules)}};
}

// Plots -----------------------------------------------------------------------

constexpr std::string_view kInputColor = "#8a8d94";

std::string_view RuleColor(DensityRule rule) {
  return rule == DensityRule::kPaper ? "#d55e00" : "#0072b2";
}

/// A histogram as a line of steps.
struct Series {
  std::string title;
  std::string_view color;
  const std::vector<int64_t>* bins = nullptr;
};

/// One of the diagrams side by side.
struct Panel {
  std::string title;
  std::string x_label;
  /// Commands that set the x axis up.
  std::string x_axis;
  /// Where the dashed line of the value aimed at is drawn.
  double aim = 0;
  std::vector<Series> series;
};

/// gnuplot's commands for `panel`; `lower_edge(bin)` is a bin's place.
template <typename LowerEdge>
std::string PanelScript(const Panel& panel, const LowerEdge& lower_edge) {
  std::string script =
      absl::StrFormat("set title \"%s\"\nset xlabel \"%s\"\n%s\n", panel.title,
                      panel.x_label, panel.x_axis);
  absl::StrAppendFormat(
      &script,
      "unset arrow\nset arrow from first %g, graph 0 to first %g, graph 0.78 "
      "nohead dashtype 2 linewidth 1.5 linecolor \"black\"\n",
      panel.aim, panel.aim);
  std::string plot;
  double top = 0;
  for (size_t s = 0; s < panel.series.size(); ++s) {
    const Series& series = panel.series[s];
    double total = 0;
    for (const int64_t count : *series.bins) {
      total += static_cast<double>(count);
    }
    absl::StrAppendFormat(&script, "$series%d << END\n", s);
    for (size_t bin = 0; bin < series.bins->size(); ++bin) {
      const double share =
          total > 0 ? 100 * static_cast<double>((*series.bins)[bin]) / total
                    : 0;
      top = std::max(top, share);
      absl::StrAppendFormat(&script, "%g %g\n%g %g\n", lower_edge(bin), share,
                            lower_edge(bin + 1), share);
    }
    script += "END\n";
    absl::StrAppendFormat(&plot, "%s $series%d with lines linewidth 2 ",
                          s == 0 ? "plot" : ",", s);
    absl::StrAppendFormat(&plot, "linecolor \"%s\" title \"%s\"",
                          std::string(series.color), series.title);
  }
  // Room for the key above the lines.
  absl::StrAppendFormat(&script, "set yrange [0:%g]\n",
                        top > 0 ? 1.3 * top : 1.0);
  return script + plot + "\n";
}

std::string FigureHead(const std::string& title) {
  return absl::StrFormat(
      "set encoding utf8\nset multiplot layout 1,3 title \"%s\"\n"
      "set key top right reverse Left samplen 1.5\nset border 3\n"
      "set tics nomirror\nset grid ytics linecolor \"#dddddd\"\n"
      "set ylabel \"share of points, %%\"\n",
      title);
}

std::string OptionsText(const FilterReport& report) {
  const core::SpdfOptions& options = report.options;
  const std::string labels =
      options.label_neighbor_count > 0
          ? absl::StrCat(", labels by ", options.label_neighbor_count)
          : "";
  return absl::StrFormat("k = %d%s, σ = %g, ρ = %g, %d points",
                         options.neighbor_count, labels, options.vote_scale_m2,
                         options.density_radius_m, report.point_count);
}

/// The bins [first, end) outside of which all series are empty.
std::pair<size_t, size_t> OccupiedBins(const std::vector<Series>& series,
                                       size_t bin_count) {
  size_t first = bin_count;
  size_t end = 0;
  for (const Series& one : series) {
    for (size_t bin = 0; bin < bin_count; ++bin) {
      if ((*one.bins)[bin] == 0) continue;
      first = std::min(first, bin);
      end = std::max(end, bin + 1);
    }
  }
  return {first, end};
}

std::string DensityScript(const FilterReport& report) {
  std::string script = FigureHead("Density reached over density aimed at: " +
                                  OptionsText(report));
  constexpr const char* kUnits[] = {"m", "m²", "m³"};
  for (const Label label : kGeometricLabels) {
    Panel panel{
        .title = absl::StrFormat("%s: %s points per %s aimed at", Name(label),
                                 FewDigits(report.target_density[Index(label)]),
                                 kUnits[LabelDimension(label) - 1]),
        .x_label = "others within ρ of a survivor / k",
        .aim = 1};
    for (const RuleReport& rule : report.rules) {
      const LabelDensity& density = rule.density[Index(label)];
      const std::string reached =
          density.reached.count == 0
              ? "no such place was dense enough"
              : absl::StrFormat("mean %.2f, 80 %%: %.2f to %.2f",
                                density.reached.mean, density.reached.p10,
                                density.reached.p90);
      panel.series.push_back({absl::StrCat(Name(rule.rule), ": ", reached),
                              RuleColor(rule.rule),
                              &density.reached_histogram});
    }
    const auto [first, end] = OccupiedBins(panel.series, RatioBins::kCount);
    panel.x_axis = absl::StrFormat(
        "set logscale x 2\nset xtics (\"1/32\" 1/32., \"1/16\" 1/16., "
        "\"1/8\" 1/8., \"1/4\" 1/4., \"1/2\" 1/2., 1, 2, 4, 8, 16, 32)\n"
        "set xrange [%g:%g]",
        std::min(0.25, RatioBins::LowerEdge(first)),
        std::max(4.0, RatioBins::LowerEdge(end)));
    script += PanelScript(panel, RatioBins::LowerEdge);
  }
  return script;
}

std::string SaliencyScript(const FilterReport& report) {
  std::string script = FigureHead(
      "Saliency of the label's own points, dashed: ideal shape at the density "
      "aimed at; " +
      OptionsText(report));
  constexpr const char* kNames[] = {"λ2 − λ3", "λ1 − λ2", "λ3"};
  const auto lower_edge = [](size_t bin) {
    return static_cast<double>(bin) * SaliencyBins::kWidth;
  };
  for (const Label label : kGeometricLabels) {
    Panel panel{.title = Name(label),
                .x_label = kNames[LabelDimension(label) - 1],
                .aim = report.expected_saliency[Index(label)]};
    const auto add = [&](const std::string& name, std::string_view color,
                         int64_t count, const SaliencyHistogram& histogram) {
      panel.series.push_back({absl::StrFormat("%s: %d points", name, count),
                              color, &histogram.labeled});
    };
    add("input", kInputColor, report.input_label_counts[Index(label)],
        report.input_saliency[Index(label)]);
    for (const RuleReport& rule : report.rules) {
      add(Name(rule.rule), RuleColor(rule.rule),
          rule.survivor_label_counts[Index(label)],
          rule.saliency[Index(label)]);
    }
    const size_t end = OccupiedBins(panel.series, SaliencyBins::kCount).second;
    panel.x_axis = absl::StrFormat("set xrange [0:%g]",
                                   std::max(lower_edge(end), 1.1 * panel.aim));
    script += PanelScript(panel, lower_edge);
  }
  return script;
}

// Runs
// -------------------------------------------------------------------------

absl::StatusOr<RuleRun> Run(const core::LatticeCloud& cloud,
                            const core::SpdfOptions& options,
                            const std::string& what, Executor& executor) {
  ProgressBar bar(what, "visits");
  const auto start = std::chrono::steady_clock::now();
  MAPSIEVE_ASSIGN_OR_RETURN(
      core::FilteredCloud filtered,
      core::FilterCloud(cloud, options,
                        {.executor = &executor, .progress = &bar}));
  const std::chrono::duration<double> elapsed =
      std::chrono::steady_clock::now() - start;
  return RuleRun{options.rule, std::move(filtered),
                 RoundSeconds(elapsed.count())};
}

}  // namespace

absl::StatusOr<FilterReport> CompareRules(const core::LatticeCloud& cloud,
                                          core::FilteredCloud filtered,
                                          double filter_s,
                                          const core::SpdfOptions& options,
                                          Executor& executor) {
  core::SpdfOptions none = options;
  none.rule = DensityRule::kPaper;
  none.max_round_count = 0;
  MAPSIEVE_ASSIGN_OR_RETURN(const RuleRun unfiltered,
                            Run(cloud, none, "votes of the input", executor));
  core::SpdfOptions other = options;
  other.rule = options.rule == DensityRule::kPaper ? DensityRule::kQuota
                                                   : DensityRule::kPaper;
  MAPSIEVE_ASSIGN_OR_RETURN(
      RuleRun other_run,
      Run(cloud, other, "rule " + Name(other.rule), executor));
  std::array<RuleRun, 2> runs = {
      RuleRun{options.rule, std::move(filtered), filter_s},
      std::move(other_run)};
  if (options.rule != DensityRule::kPaper) std::swap(runs[0], runs[1]);
  return MakeFilterReport(cloud, unfiltered.filtered, runs, options,
                          {.executor = &executor});
}

absl::Status WriteReport(const FilterReport& report,
                         const std::filesystem::path& folder) {
  MAPSIEVE_RETURN_IF_ERROR(MakeFolder(folder));
  MAPSIEVE_RETURN_IF_ERROR(
      WriteFile(folder / "report.json", ReportJson(report).dump(2) + "\n"));
  constexpr PlotSize kSize = {1500, 460};
  MAPSIEVE_RETURN_IF_ERROR(
      WritePlot(folder, "density", DensityScript(report), kSize).status());
  return WritePlot(folder, "saliencies", SaliencyScript(report), kSize)
      .status();
}

}  // namespace mapsieve::client
