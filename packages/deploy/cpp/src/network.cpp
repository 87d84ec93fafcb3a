#include "network.hpp"

#include <ATen/Parallel.h>
#include <torch/script.h>

#include <stdexcept>

namespace legged {

struct Network::Torch {
  torch::jit::Module module;
  std::vector<at::Tensor> state;
};

Network::Network(const Bundle& bundle, const Graph& graph)
    : torch_(std::make_unique<Torch>()), path_(bundle.path(graph.file)), graph_(graph) {
  at::set_num_threads(1);  // one image or observation at a time: threads cost more than they give
  try {
    torch_->module = torch::jit::load(path_, at::kCPU);
    torch_->module.eval();
  } catch (const c10::Error& error) {
    throw std::runtime_error(path_ + ": LibTorch cannot load it (" + error.what_without_backtrace() +
                             "); export the bundle again");
  }
  reset();
}

Network::~Network() = default;

void Network::reset() {
  torch_->state.clear();
  for (const RecurrentState& state : graph_.state) torch_->state.push_back(at::zeros(state.shape));
}

std::map<std::string, std::vector<float>> Network::run(const std::map<std::string, std::vector<float>>& inputs) {
  const c10::InferenceMode guard;
  std::vector<c10::IValue> arguments;  // in the order of the manifest, the state last
  for (const Tensor& input : graph_.inputs) {
    const std::vector<float>& values = inputs.at(input.name);
    at::Tensor tensor = at::empty(input.shape);
    if (static_cast<std::size_t>(tensor.numel()) != values.size())
      throw std::runtime_error(path_ + ": input " + input.name + " has " + std::to_string(values.size()) +
                               " numbers, the manifest says " + std::to_string(tensor.numel()));
    std::copy(values.begin(), values.end(), tensor.data_ptr<float>());
    arguments.emplace_back(tensor);
  }
  arguments.insert(arguments.end(), torch_->state.begin(), torch_->state.end());

  c10::IValue result;
  try {
    result = torch_->module.forward(arguments);
  } catch (const std::exception& error) {
    throw std::runtime_error(path_ + ": the network fails: " + error.what());
  }
  if (!result.isTuple() || result.toTupleRef().elements().size() != graph_.outputs.size() + graph_.state.size())
    throw std::runtime_error(path_ + ": gives other results than the manifest says; export the bundle again");
  const auto& elements = result.toTupleRef().elements();
  std::map<std::string, std::vector<float>> outputs;
  for (std::size_t i = 0; i < graph_.outputs.size(); ++i) {
    const at::Tensor tensor = elements[i].toTensor().contiguous();
    const float* values = tensor.data_ptr<float>();
    outputs[graph_.outputs[i].name].assign(values, values + tensor.numel());
  }
  for (std::size_t i = 0; i < graph_.state.size(); ++i)
    torch_->state[i] = elements[graph_.outputs.size() + i].toTensor();
  return outputs;
}

}  // namespace legged
