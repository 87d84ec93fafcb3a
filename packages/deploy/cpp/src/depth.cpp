#include "depth.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <stdexcept>

namespace legged {
namespace {

constexpr double kBlindShare = 0.05;  // of the image that a camera may miss
constexpr double kLeastMeasured = 0.1;  // share of the image, as LEAST_MEASURED of preprocess.py
constexpr double kTie = 1e-6;         // px, so that rounding does not choose between two pixels

// Where the pixels of one axis of the image lie in the frame: the pixel under the ray, and the footprint.
struct Span {
  long centre, first, last;
  bool seen;
};

struct Axis {
  double focal, principal;
};

std::vector<Span> map_axis(long count, Axis image, long size, Axis frame) {
  const auto to_frame = [&](double position) {
    return (position - image.principal) / image.focal * frame.focal + frame.principal + kTie;
  };
  const auto edge = [&](long pixel) {
    return static_cast<long>(std::ceil(to_frame(static_cast<double>(pixel)) - 0.5 - 2 * kTie));
  };
  std::vector<Span> spans;
  for (long pixel = 0; pixel < count; ++pixel) {
    const auto centre = static_cast<long>(std::floor(to_frame(static_cast<double>(pixel) + 0.5)));
    const long first = std::min(edge(pixel), centre), last = std::max(edge(pixel + 1) - 1, centre);
    spans.push_back({std::clamp(centre, 0L, size - 1), std::clamp(first, 0L, size - 1),
                     std::clamp(last, 0L, size - 1), centre >= 0 && centre < size});
  }
  return spans;
}

Intrinsics nominal(const DepthOptics& optics, const DepthFrame& frame) {
  const double y = static_cast<double>(frame.height) / static_cast<double>(optics.raw_rows);
  const double x = static_cast<double>(frame.width) / static_cast<double>(optics.raw_columns);
  if (std::fabs(x - y) > 0.02 * std::max(x, y))
    throw std::runtime_error("depth camera: its frames have another aspect ratio than the policy's sensor; choose "
                             "another stream or give the camera's intrinsics");
  const double kept_x = static_cast<double>(optics.raw_columns - 2 * optics.crop_sides) /
                        static_cast<double>(optics.columns);
  const double kept_y = static_cast<double>(optics.raw_rows - optics.crop_bottom) / static_cast<double>(optics.rows);
  const Intrinsics& lens = optics.intrinsics;
  return {lens.fx * kept_x * x, lens.fy * kept_y * y,
          (lens.cx * kept_x + static_cast<double>(optics.crop_sides)) * x, lens.cy * kept_y * y};
}

bool is_measured(float depth) { return depth > 0.0f || depth == -std::numeric_limits<float>::infinity(); }

// The measurement under the ray, else the nearest one of the footprint, then by row, then by column; NaN without any.
float sample(const DepthFrame& frame, const Span& row, const Span& column) {
  const auto at = [&](long r, long c) { return frame.metres[static_cast<std::size_t>(r * frame.width + c)]; };
  const float centre = at(row.centre, column.centre);
  if (is_measured(centre)) return centre;
  float best = std::numeric_limits<float>::quiet_NaN();
  long nearest = std::numeric_limits<long>::max();
  for (long r = row.first; r <= row.last; ++r)
    for (long c = column.first; c <= column.last; ++c) {
      const long distance = (r - row.centre) * (r - row.centre) + (c - column.centre) * (c - column.centre);
      if (distance < nearest && is_measured(at(r, c))) {
        nearest = distance;
        best = at(r, c);
      }
    }
  return best;
}

std::string fault_of(const std::vector<float>& metres, double measured) {
  if (measured >= kLeastMeasured) return "";
  if (std::all_of(metres.begin(), metres.end(), [](float depth) { return std::isnan(depth); }))
    return "depth: every pixel is NaN, the camera measures nothing; check its driver and its projector";
  if (std::all_of(metres.begin(), metres.end(), [](float depth) { return depth == 0.0f; }))
    return "depth: every pixel is 0, as from a covered lens or a stalled stream; check the camera";
  if (measured == 0.0) return "depth: no pixel holds a measurement; check the camera";
  char words[120];
  std::snprintf(words, sizeof words,
                "depth: only %.1f%% of the image is measured, need %.0f%%; check the lens, the light and the distance",
                measured * 100, kLeastMeasured * 100);
  return words;
}

}  // namespace

DepthReading preprocess(const DepthOptics& optics, const DepthFrame& frame) {
  if (frame.height < 1 || frame.width < 1 ||
      frame.metres.size() != static_cast<std::size_t>(frame.height * frame.width))
    throw std::runtime_error("depth camera: a frame has not height * width pixels");
  const bool ready = !frame.intrinsics && frame.height == optics.rows && frame.width == optics.columns;
  const Intrinsics lens = frame.intrinsics ? *frame.intrinsics : ready ? optics.intrinsics : nominal(optics, frame);
  const Intrinsics& wanted = optics.intrinsics;
  const auto rows = map_axis(optics.rows, {wanted.fy, wanted.cy}, frame.height, {lens.fy, lens.cy});
  const auto columns = map_axis(optics.columns, {wanted.fx, wanted.cx}, frame.width, {lens.fx, lens.cx});

  const auto near = static_cast<float>(optics.near), far = static_cast<float>(optics.far);
  const auto range = static_cast<float>(optics.far - optics.near);
  DepthReading reading{{}, 0.0, ""};
  long seen = 0, measured = 0;
  for (const Span& row : rows)
    for (const Span& column : columns) {
      float depth = std::numeric_limits<float>::quiet_NaN();
      if (row.seen && column.seen) {
        ++seen;
        depth = sample(frame, row, column);
      }
      measured += !std::isnan(depth);
      if (std::isnan(depth)) depth = far;
      reading.image.push_back((std::clamp(depth, near, far) - near) / range - 0.5f);
    }
  const auto pixels = static_cast<double>(optics.rows * optics.columns);
  if (const double blind = 1.0 - static_cast<double>(seen) / pixels; blind > kBlindShare)
    throw std::runtime_error("depth camera: its field of view misses " + std::to_string(std::lround(blind * 100)) +
                             "% of the image that the policy was trained with; choose a wider stream");
  reading.measured = static_cast<double>(measured) / pixels;
  reading.fault = fault_of(frame.metres, reading.measured);
  return reading;
}

}  // namespace legged
