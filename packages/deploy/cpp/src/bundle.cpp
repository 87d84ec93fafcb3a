#include "bundle.hpp"

#include <stdexcept>

#include "json.hpp"
#include "npy.hpp"

namespace legged {
namespace {

std::vector<long> shape(const Json& entry) {
  std::vector<long> found;
  for (const Json& length : entry.array()) found.push_back(length.integer());
  return found;
}

Graph graph(const Json& entry) {
  if (!entry.has("torchscript"))
    throw std::runtime_error("\"torchscript\" is missing: this runner needs it; export the bundle with TorchScript");
  Graph found{entry["torchscript"].string(), {}, {}, {}};
  for (const auto& [name, lengths] : entry["inputs"].object()) found.inputs.push_back({name, shape(lengths)});
  for (const auto& [name, lengths] : entry["outputs"].object()) found.outputs.push_back({name, shape(lengths)});
  for (const Json& state : entry["state"].array())
    found.state.push_back({state["input"].string(), state["output"].string(), shape(state["shape"])});
  return found;
}

Term term(const Json& entry) {
  const Json& scale = entry["scale"];
  const auto size = static_cast<std::size_t>(entry["size"].integer());
  Term found{entry["source"].string(),
             scale.is_array() ? scale.numbers() : std::vector<double>(size, scale.number())};
  if (found.scale.size() != size) throw std::runtime_error("a scale has not one factor per element");
  return found;
}

Depth depth(const Json& entry) {
  const Json &image = entry["image"], &camera = entry["camera"];
  const std::vector<long> raw = shape(camera["raw_size"]);
  if (raw.size() != 2) throw std::runtime_error("\"raw_size\" has not two lengths");
  const Intrinsics lens{camera["fx"].number(), camera["fy"].number(), camera["cx"].number(), camera["cy"].number()};
  return {graph(entry), entry["period_ticks"].integer(), entry["latency_ticks"].integer(),
          {image["rows"].integer(), image["columns"].integer(), lens, camera["near"].number(),
           camera["far"].number(), raw[0], raw[1], camera["crop_bottom"].integer(),
           camera["crop_sides"].integer()}};
}

Bundle build(const std::string& root, const Json& manifest) {
  if (const long version = manifest["schema_version"].integer(); version != 1)
    throw std::runtime_error("schema_version is " + std::to_string(version) + ", this runner reads 1");
  Bundle bundle;
  bundle.root = root;
  bundle.name = manifest["name"].string();
  for (const Json& joint : manifest["joints"].array())
    bundle.joints.push_back({joint["name"].string(), joint["stance"].number(), joint["target_offset"].number(),
                             joint["kp"].number(), joint["kd"].number(), joint["torque_limit"].number(),
                             joint["lower"].number(), joint["upper"].number()});
  for (const Json& foot : manifest["robot"]["feet"].array()) bundle.feet.push_back(foot.string());
  bundle.action_scale = manifest["action"]["scale"].number();
  if (const Json& clip = manifest["action"]["clip"]; !clip.is_null()) bundle.action_clip = clip.number();
  bundle.policy_hz = manifest["rates"]["policy_hz"].number();
  for (const Json& entry : manifest["observation"]["terms"].array()) bundle.terms.push_back(term(entry));
  bundle.policy = graph(manifest["policy"]);
  if (manifest.has("depth")) bundle.depth = depth(manifest["depth"]);
  bundle.golden = manifest["golden"]["file"].string();
  bundle.golden_ticks = manifest["golden"]["ticks"].integer();
  bundle.golden_atol = manifest["golden"]["atol"].number();
  if (bundle.golden_ticks < 1 || !(bundle.golden_atol > 0 && bundle.golden_atol <= 1e-3))
    throw std::runtime_error("\"golden\" needs a tick at least and an atol of up to 0.001");
  return bundle;
}

}  // namespace

Bundle Bundle::load(const std::string& root) {
  const std::string path = root + "/manifest.json";
  const std::string text = read_file(path);
  try {
    return build(root, Json::parse(text));
  } catch (const std::exception& error) {
    throw std::runtime_error(path + ": " + error.what());
  }
}

}  // namespace legged
