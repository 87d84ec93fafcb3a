// An exported network with its recurrent state.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "bundle.hpp"

namespace legged {

class Network {
 public:
  // Loads the TorchScript file; throws std::runtime_error that names it.
  Network(const Bundle& bundle, const Graph& graph);
  ~Network();

  // Puts the recurrent state to zeros.
  void reset();

  // Runs once and moves the recurrent state on. `inputs` and the result hold values by name, without the state.
  std::map<std::string, std::vector<float>> run(const std::map<std::string, std::vector<float>>& inputs);

 private:
  struct Torch;  // keeps the headers of LibTorch out of those who use a network
  std::unique_ptr<Torch> torch_;
  std::string path_;
  Graph graph_;
};

}  // namespace legged
