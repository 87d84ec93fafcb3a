// Arrays of numpy: .npy files, and .npz archives of them.
#pragma once

#include <map>
#include <string>
#include <vector>

namespace legged {

struct Array {
  std::vector<std::size_t> shape;
  std::vector<double> data;  // C order; bool, uint16, float32 and float64 fit exactly
  bool is_integer = false;   // counts rather than quantities

  std::size_t row_size() const;  // elements of one entry of the first axis
};

// All throw std::runtime_error that names the file.
Array read_npy(const std::string& path);
std::map<std::string, Array> read_npz(const std::string& path);
void write_npy(const std::string& path, const std::vector<std::size_t>& shape, const std::vector<float>& data);

// The whole of a file.
std::string read_file(const std::string& path);

}  // namespace legged
