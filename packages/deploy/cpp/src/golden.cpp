#include "golden.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <stdexcept>

#include "npy.hpp"

namespace legged {
namespace {

using Trace = std::map<std::string, Array>;

const Array& entry(const Trace& trace, const std::string& name, std::size_t ticks) {
  const auto found = trace.find(name);
  if (found == trace.end()) throw std::runtime_error("golden trace: " + name + " is missing; export the bundle again");
  if (ticks != 0 && (found->second.shape.empty() || found->second.shape[0] != ticks))
    throw std::runtime_error("golden trace: " + name + " has not one entry per tick; export the bundle again");
  return found->second;
}

// Entry `tick` of an array.
template <typename T = double>
std::vector<T> row(const Array& array, std::size_t tick) {
  const auto begin = array.data.begin() + static_cast<std::ptrdiff_t>(tick * array.row_size());
  return {begin, begin + static_cast<std::ptrdiff_t>(array.row_size())};
}

template <std::size_t N>
std::array<double, N> fixed(const Array& array, std::size_t tick) {
  if (array.row_size() != N) throw std::runtime_error("golden trace: wrong shape; export the bundle again");
  std::array<double, N> values;
  std::copy_n(array.data.begin() + static_cast<std::ptrdiff_t>(tick * N), N, values.begin());
  return values;
}

// Largest difference; NaN if there is one, or if the sizes differ.
template <typename T>
double difference(const std::vector<T>& found, const std::vector<double>& wanted) {
  if (found.size() != wanted.size()) return std::nan("");
  double worst = 0.0;
  for (std::size_t i = 0; i < found.size(); ++i) {
    const double error = std::fabs(static_cast<double>(found[i]) - wanted[i]);
    if (std::isnan(error)) return error;
    worst = std::max(worst, error);
  }
  return worst;
}

}  // namespace

bool check_golden(Policy& policy) {
  const Bundle& bundle = policy.bundle();
  const Trace trace = read_npz(bundle.path(bundle.golden));
  const Array& reset = entry(trace, "reset", 0);
  const std::size_t ticks = reset.data.size();
  if (ticks != static_cast<std::size_t>(bundle.golden_ticks))
    throw std::runtime_error("golden trace: has " + std::to_string(ticks) + " ticks, manifest.json says " +
                             std::to_string(bundle.golden_ticks) + "; export the bundle again");
  const bool sees = bundle.depth.has_value(), feels = trace.count("contact") != 0;
  std::map<std::string, double> worst;
  std::vector<double> times;
  std::size_t images = 0;
  for (std::size_t tick = 0; tick < ticks; ++tick) {
    if (reset.data[tick] != 0.0) policy.reset();
    RobotState state{row(entry(trace, "q", ticks), tick), row(entry(trace, "dq", ticks), tick),
                     fixed<4>(entry(trace, "quat_wxyz", ticks), tick), fixed<3>(entry(trace, "gyro", ticks), tick),
                     fixed<3>(entry(trace, "command", ticks), tick), {}};
    if (feels)
      for (const double foot : row(entry(trace, "contact", ticks), tick)) state.contact.push_back(foot != 0.0);
    std::vector<float> image;
    if (policy.image_due()) {
      const Array& depth = entry(trace, "depth", 0);
      if (depth.shape.empty() || images >= depth.shape[0])
        throw std::runtime_error("golden trace: too few images; export the bundle again");
      image = row<float>(depth, images++);
    }
    const auto begin = std::chrono::steady_clock::now();
    const PolicyStep step = policy.step(state, image);
    times.push_back(std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begin).count());
    const auto compare = [&](const char* name, const auto& found) {
      const double error = difference(found, row(entry(trace, name, ticks), tick));
      double& largest = worst[name];
      if (std::isnan(error) || error > largest) largest = error;  // a NaN stays
    };
    compare("obs", step.obs);
    compare("action", step.action);
    compare("target", step.target);
    if (sees) {
      compare("terrain", step.terrain);
      compare("heading", step.heading);
    }
  }
  policy.reset();

  bool good = true;
  std::printf("%s: %zu ticks\n", bundle.name.c_str(), ticks);
  for (const auto& [name, error] : worst) {
    const bool within = error <= bundle.golden_atol;
    std::printf("  %-8s largest difference %.3g%s\n", name.c_str(), error, within ? "" : "  TOO LARGE");
    good = good && within;
  }
  std::sort(times.begin(), times.end());
  std::printf("  tick     %.0f us median, %.0f us at the 99th percentile\n", times[ticks / 2], times[ticks * 99 / 100]);
  return good;
}

}  // namespace legged
