// A JSON document, enough of it to read a manifest.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace legged {

class Json {
 public:
  using Array = std::vector<Json>;
  // In the order of the file: it is the order of a network's arguments.
  using Object = std::vector<std::pair<std::string, Json>>;

  // Throws std::runtime_error with the position of the fault.
  static Json parse(const std::string& text);

  bool is_null() const { return std::holds_alternative<std::nullptr_t>(value_); }
  bool is_array() const { return std::holds_alternative<std::unique_ptr<Array>>(value_); }
  bool has(const std::string& key) const;

  // Each throws std::runtime_error where the document holds something else.
  const Json& operator[](const std::string& key) const;
  const Array& array() const;
  const Object& object() const;
  double number() const;
  long integer() const;
  const std::string& string() const;
  std::vector<double> numbers() const;

 private:
  friend class JsonParser;
  std::variant<std::nullptr_t, bool, double, std::string, std::unique_ptr<Array>, std::unique_ptr<Object>> value_;
};

}  // namespace legged
