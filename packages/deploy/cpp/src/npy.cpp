#include "npy.hpp"

#include <zlib.h>

#include <cstdint>
#include <cstring>
#include <fstream>
#include <numeric>
#include <sstream>
#include <stdexcept>

// numpy writes the byte order of its machine, and so does a zip archive: both are little-endian here.
namespace legged {
namespace {

[[noreturn]] void fail(const std::string& path, const std::string& what) {
  throw std::runtime_error(path + ": " + what + "; export the bundle again");
}

template <typename T>
T at(const std::string& bytes, std::size_t offset) {
  if (offset > bytes.size() || bytes.size() - offset < sizeof(T)) throw std::out_of_range("cut off");
  T value;
  std::memcpy(&value, bytes.data() + offset, sizeof(T));
  return value;
}

std::string piece(const std::string& bytes, std::size_t offset, std::size_t size) {
  if (offset > bytes.size() || bytes.size() - offset < size) throw std::out_of_range("cut off");
  return bytes.substr(offset, size);
}

// Text behind `key` in the header of an .npy, a Python dictionary, up to one of `stops`.
std::string header_entry(const std::string& header, const std::string& key, const char* stops) {
  const std::size_t place = header.find("'" + key + "':");
  if (place == std::string::npos) throw std::out_of_range("no " + key);
  const std::size_t begin = header.find_first_not_of(" '(", place + key.size() + 3);
  return header.substr(begin, header.find_first_of(stops, begin) - begin);
}

template <typename T>
std::vector<double> widen(const std::string& bytes, std::size_t offset, std::size_t count) {
  const std::string block = piece(bytes, offset, count * sizeof(T));
  std::vector<T> raw(count);
  std::memcpy(raw.data(), block.data(), block.size());
  return {raw.begin(), raw.end()};
}

Array parse_npy(const std::string& bytes) {
  if (piece(bytes, 0, 6) != "\x93NUMPY") throw std::out_of_range("not an .npy");
  const bool first_version = at<std::uint8_t>(bytes, 6) == 1;
  const std::size_t begin = first_version ? 10 : 12;
  const std::size_t size = first_version ? at<std::uint16_t>(bytes, 8) : at<std::uint32_t>(bytes, 8);
  const std::string header = piece(bytes, begin, size);
  if (header_entry(header, "fortran_order", ",}") != "False") throw std::out_of_range("Fortran order");
  Array array;
  std::stringstream shape(header_entry(header, "shape", ")"));
  for (std::string length; std::getline(shape, length, ',');)
    if (length.find_first_not_of(' ') != std::string::npos) array.shape.push_back(std::stoul(length));
  const std::size_t count =
      std::accumulate(array.shape.begin(), array.shape.end(), std::size_t{1}, std::multiplies<std::size_t>());
  if (count > bytes.size()) throw std::out_of_range("cut off");
  const std::string type = header_entry(header, "descr", "'");
  const std::size_t data = begin + size;
  array.is_integer = type == "|b1" || type == "<u2";
  if (type == "<f4") {
    array.data = widen<float>(bytes, data, count);
  } else if (type == "<f8") {
    array.data = widen<double>(bytes, data, count);
  } else if (type == "<u2") {
    array.data = widen<std::uint16_t>(bytes, data, count);
  } else if (type == "|b1") {
    array.data = widen<std::uint8_t>(bytes, data, count);
  } else {
    throw std::out_of_range("numbers of type " + type);
  }
  return array;
}

std::string inflate_raw(const std::string& packed, std::size_t size) {
  std::string bytes(size, '\0');
  z_stream stream{};
  if (inflateInit2(&stream, -MAX_WBITS) != Z_OK) throw std::runtime_error("zlib does not start");
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(packed.data()));
  stream.avail_in = static_cast<uInt>(packed.size());
  stream.next_out = reinterpret_cast<Bytef*>(bytes.data());
  stream.avail_out = static_cast<uInt>(bytes.size());
  const int status = inflate(&stream, Z_FINISH);
  inflateEnd(&stream);
  if (status != Z_STREAM_END || stream.total_out != size) throw std::out_of_range("damaged");
  return bytes;
}

// One file of a zip archive whose entry in the central directory begins at `entry`.
std::string unpack(const std::string& zip, std::size_t entry) {
  const std::size_t packed = at<std::uint32_t>(zip, entry + 20), size = at<std::uint32_t>(zip, entry + 24);
  const std::size_t local = at<std::uint32_t>(zip, entry + 42);
  const std::size_t data = local + 30 + at<std::uint16_t>(zip, local + 26) + at<std::uint16_t>(zip, local + 28);
  const auto method = at<std::uint16_t>(zip, entry + 10);
  if (method != 0 && method != 8) throw std::out_of_range("compressed in an unknown way");
  const std::string block = piece(zip, data, packed);
  std::string bytes = method == 0 ? block : inflate_raw(block, size);
  const uLong crc = crc32(0, reinterpret_cast<const Bytef*>(bytes.data()), static_cast<uInt>(bytes.size()));
  if (crc != at<std::uint32_t>(zip, entry + 16)) throw std::out_of_range("damaged");
  return bytes;
}

std::map<std::string, Array> parse_npz(const std::string& zip) {
  const std::size_t end = zip.rfind("PK\5\6");
  if (end == std::string::npos) throw std::out_of_range("not a zip archive, or torn");
  std::map<std::string, Array> arrays;
  std::size_t entry = at<std::uint32_t>(zip, end + 16);
  for (int left = at<std::uint16_t>(zip, end + 10); left > 0; --left) {
    const std::size_t name_size = at<std::uint16_t>(zip, entry + 28);
    const std::string name = piece(zip, entry + 46, name_size);
    arrays[name.substr(0, name.rfind(".npy"))] = parse_npy(unpack(zip, entry));
    entry += 46 + name_size + at<std::uint16_t>(zip, entry + 30) + at<std::uint16_t>(zip, entry + 32);
  }
  return arrays;
}

}  // namespace

std::size_t Array::row_size() const { return shape.empty() || shape[0] == 0 ? 0 : data.size() / shape[0]; }

std::string read_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error(path + ": cannot be read; is this the folder of a bundle?");
  std::ostringstream bytes;
  bytes << file.rdbuf();
  return bytes.str();
}

Array read_npy(const std::string& path) {
  try {
    return parse_npy(read_file(path));
  } catch (const std::logic_error& error) {
    throw std::runtime_error(path + ": not an array of numpy: " + error.what());
  }
}

std::map<std::string, Array> read_npz(const std::string& path) {
  try {
    return parse_npz(read_file(path));
  } catch (const std::logic_error& error) {
    fail(path, std::string("not arrays of numpy: ") + error.what());
  }
}

void write_npy(const std::string& path, const std::vector<std::size_t>& shape, const std::vector<float>& data) {
  std::string header = "{'descr': '<f4', 'fortran_order': False, 'shape': (";
  for (const std::size_t length : shape) header += std::to_string(length) + ",";
  header += "), }";
  while ((10 + header.size() + 1) % 64 != 0) header += ' ';
  header += '\n';
  std::ofstream file(path, std::ios::binary);
  const auto size = static_cast<std::uint16_t>(header.size());
  file.write("\x93NUMPY\1\0", 8).write(reinterpret_cast<const char*>(&size), 2) << header;
  file.write(reinterpret_cast<const char*>(data.data()), static_cast<std::streamsize>(data.size() * sizeof(float)));
  if (!file.flush()) throw std::runtime_error(path + ": cannot be written");
}

}  // namespace legged
