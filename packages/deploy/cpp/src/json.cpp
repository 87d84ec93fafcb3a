#include "json.hpp"

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <stdexcept>

namespace legged {

class JsonParser {
 public:
  explicit JsonParser(const std::string& text) : text_(text) {}

  Json document() {
    Json found = value();
    skip_space();
    if (at_ != text_.size()) fail("more text after the end");
    return found;
  }

 private:
  static constexpr int kDeepest = 64;

  [[noreturn]] void fail(const std::string& what) const {
    throw std::runtime_error("not valid JSON at byte " + std::to_string(at_) + ": " + what);
  }

  void skip_space() {
    while (at_ < text_.size() && std::strchr(" \t\r\n", text_[at_])) ++at_;
  }

  char peek() {
    skip_space();
    if (at_ >= text_.size()) fail("the text ends early");
    return text_[at_];
  }

  bool take(char wanted) {
    if (peek() != wanted) return false;
    ++at_;
    return true;
  }

  void expect(char wanted) {
    if (!take(wanted)) fail(std::string("expected ") + wanted);
  }

  bool word(const char* wanted) {
    if (text_.compare(at_, std::strlen(wanted), wanted) != 0) return false;
    at_ += std::strlen(wanted);
    return true;
  }

  Json value() {
    if (++depth_ > kDeepest) fail("nested too deeply");
    Json found;
    const char first = peek();
    if (first == '{') {
      found.value_ = object();
    } else if (first == '[') {
      found.value_ = array();
    } else if (first == '"') {
      found.value_ = string();
    } else if (word("null")) {
      found.value_ = nullptr;
    } else if (word("true")) {
      found.value_ = true;
    } else if (word("false")) {
      found.value_ = false;
    } else {
      found.value_ = number();
    }
    --depth_;
    return found;
  }

  std::unique_ptr<Json::Object> object() {
    auto found = std::make_unique<Json::Object>();
    expect('{');
    if (take('}')) return found;
    do {
      if (peek() != '"') fail("expected a name");
      std::string name = string();
      expect(':');
      found->emplace_back(std::move(name), value());
    } while (take(','));
    expect('}');
    return found;
  }

  std::unique_ptr<Json::Array> array() {
    auto found = std::make_unique<Json::Array>();
    expect('[');
    if (take(']')) return found;
    do found->push_back(value());
    while (take(','));
    expect(']');
    return found;
  }

  std::string string() {
    std::string found;
    for (++at_; at_ < text_.size() && text_[at_] != '"'; ++at_) {
      if (text_[at_] != '\\') {
        found += text_[at_];
        continue;
      }
      if (++at_ >= text_.size()) break;
      const char* known = "\"\\/bfnrt";
      const char* means = "\"\\/\b\f\n\r\t";
      if (const char* place = std::strchr(known, text_[at_]); place && *place) {
        found += means[place - known];
      } else if (text_[at_] == 'u' && at_ + 4 < text_.size()) {
        append_utf8(found, static_cast<unsigned>(std::stoul(text_.substr(at_ + 1, 4), nullptr, 16)));
        at_ += 4;
      } else {
        fail("unknown escape");
      }
    }
    if (at_ >= text_.size()) fail("a string does not end");
    ++at_;
    return found;
  }

  // Characters beyond 16 bits come as two surrogates; names in a manifest have none, texts are not read.
  static void append_utf8(std::string& text, unsigned code) {
    if (code < 0x80) {
      text += static_cast<char>(code);
    } else if (code < 0x800) {
      text += static_cast<char>(0xC0 | code >> 6);
      text += static_cast<char>(0x80 | (code & 0x3F));
    } else {
      text += static_cast<char>(0xE0 | code >> 12);
      text += static_cast<char>(0x80 | (code >> 6 & 0x3F));
      text += static_cast<char>(0x80 | (code & 0x3F));
    }
  }

  double number() {
    const char* begin = text_.c_str() + at_;
    if (!std::strchr("-0123456789", *begin)) fail("expected a value");
    char* end = nullptr;
    const double found = std::strtod(begin, &end);
    if (end == begin || !std::isfinite(found)) fail("not a number");
    at_ += static_cast<std::size_t>(end - begin);
    return found;
  }

  const std::string& text_;
  std::size_t at_ = 0;
  int depth_ = 0;
};

namespace {

template <typename T, typename Variant>
const T& get(const Variant& value, const char* wanted) {
  if (const T* found = std::get_if<T>(&value)) return *found;
  throw std::runtime_error(std::string("expected ") + wanted);
}

}  // namespace

Json Json::parse(const std::string& text) { return JsonParser(text).document(); }

const Json::Array& Json::array() const { return *get<std::unique_ptr<Array>>(value_, "a list"); }

const Json::Object& Json::object() const { return *get<std::unique_ptr<Object>>(value_, "an object"); }

double Json::number() const { return get<double>(value_, "a number"); }

const std::string& Json::string() const { return get<std::string>(value_, "a string"); }

long Json::integer() const {
  const double found = number();
  if (found != std::floor(found) || std::fabs(found) > 1e9) throw std::runtime_error("expected a whole number");
  return static_cast<long>(found);
}

std::vector<double> Json::numbers() const {
  std::vector<double> found;
  for (const Json& entry : array()) found.push_back(entry.number());
  return found;
}

bool Json::has(const std::string& key) const {
  for (const auto& [name, _] : object())
    if (name == key) return true;
  return false;
}

const Json& Json::operator[](const std::string& key) const {
  for (const auto& [name, entry] : object())
    if (name == key) return entry;
  throw std::runtime_error("\"" + key + "\" is missing");
}

}  // namespace legged
