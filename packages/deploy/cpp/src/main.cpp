// Runs a bundle of legged-deploy on LibTorch.
#include <cmath>
#include <cstdio>
#include <cstring>
#include <exception>
#include <stdexcept>

#include "depth.hpp"
#include "golden.hpp"
#include "npy.hpp"
#include "policy.hpp"

namespace {

constexpr const char* kUsage =
    "legged_runner BUNDLE --golden               replay the recorded trace; status 0 if it is reproduced\n"
    "legged_runner BUNDLE --depth IN.npy OUT.npy [FX FY CX CY]\n"
    "                                            preprocess a frame: uint16 mm or float32 m -> float32 image\n"
    "The hashes of the files are not checked here: `deploy doctor BUNDLE` does.\n";

int golden(const char* folder) {
  legged::Policy policy(legged::Bundle::load(folder));
  return legged::check_golden(policy) ? 0 : 1;
}

int depth(int count, char** words) {
  const legged::Bundle bundle = legged::Bundle::load(words[1]);
  if (!bundle.depth) throw std::runtime_error(std::string(words[1]) + ": the policy is blind");
  const legged::Array raw = legged::read_npy(words[3]);
  if (raw.shape.size() != 2) throw std::runtime_error(std::string(words[3]) + ": not an image");
  legged::DepthFrame frame{static_cast<long>(raw.shape[0]), static_cast<long>(raw.shape[1]), {}, {}};
  for (const double value : raw.data)
    frame.metres.push_back(raw.is_integer ? static_cast<float>(value) * 1e-3f : static_cast<float>(value));
  if (count == 9) frame.intrinsics = {std::atof(words[5]), std::atof(words[6]), std::atof(words[7]), std::atof(words[8])};
  const legged::DepthOptics& optics = bundle.depth->optics;
  const legged::DepthReading reading = legged::preprocess(optics, frame);
  const auto rows = static_cast<std::size_t>(optics.rows), columns = static_cast<std::size_t>(optics.columns);
  legged::write_npy(words[4], {rows, columns}, reading.image);
  std::printf("measured %.6f\n%s\n", reading.measured, reading.fault.c_str());
  return 0;
}

}  // namespace

int main(int count, char** words) {
  try {
    if (count == 3 && !std::strcmp(words[2], "--golden")) return golden(words[1]);
    if ((count == 5 || count == 9) && !std::strcmp(words[2], "--depth")) return depth(count, words);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "legged_runner: %s\n", error.what());
    return 1;
  }
  std::fputs(kUsage, stderr);
  return 2;
}
