// The lines of a text, the words of a line, and the numbers that words are.
#pragma once

#include <fast_float/fast_float.h>

#include <array>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <system_error>
#include <type_traits>
#include <utility>

#include "text/records.hpp"

namespace masat {

constexpr bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r'; }
constexpr bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); }
constexpr bool starts_number(char c) {
  return (c >= '0' && c <= '9') || c == '-' || c == '+' || c == '.';
}

// The words of one line, separated by blanks, up to a comment.
class Line {
 public:
  Line(std::string_view text, std::int64_t number)
      : at_(text.data()), end_(text.data() + text.size()), size_(text.size()), number_(number) {
    skip_blanks();
  }

  bool done() const { return at_ == end_; }
  char peek() const { return *at_; }
  std::int64_t number() const { return number_; }
  std::size_t size() const { return size_; }
  // What follows the '#'; known when the line is done.
  std::string_view comment() const { return comment_; }

  std::string_view word() {
    const char* const begin = at_;
    while (at_ != end_ && !is_space(*at_)) ++at_;
    const std::string_view w(begin, at_ - begin);
    skip_blanks();
    return w;
  }

  // Reads the next word as a number of type T. On an error nothing is consumed: the word is no
  // number, or one whose magnitude is too large for T. A double below the smallest one reads as 0.
  template <class T>
  std::errc try_number(T& value) {
    if constexpr (std::is_same_v<T, double>) {
      if (const char* const end = short_decimal(value)) {
        at_ = end;
        skip_blanks();
        return {};
      }
    }
    const char* begin = at_;
    if (begin != end_ && *begin == '+') {  // from_chars knows no plus sign
      ++begin;
      if (begin == end_ || *begin == '-') return std::errc::invalid_argument;
    }
    const auto [end, error] = from_chars(begin, value);
    if (end != end_ && !is_space(*end)) return std::errc::invalid_argument;
    if (error == std::errc{}) {
      at_ = end;
      skip_blanks();
    }
    return error;
  }

  [[noreturn]] void fail(const std::string& what) const { throw ParseError(number_, what); }

 private:
  std::pair<const char*, std::errc> from_chars(const char* begin, std::int64_t& value) const {
    const auto [end, error] = std::from_chars(begin, end_, value);
    return {end, error};
  }

  // The floating std::from_chars is missing in libc++ before version 20, and strtod reads the
  // decimal point of the process's locale.
  std::pair<const char*, std::errc> from_chars(const char* begin, double& value) const {
    const auto [end, error] = fast_float::from_chars(begin, end_, value);
    const bool overflow = error == std::errc{} && std::isinf(value) && !is_letter(end[-1]);
    return {end, overflow ? std::errc::result_out_of_range : error};
  }

  // Reads a decimal without exponent of at most 15 digits, the most common kind: an integer below
  // 2^53 divided by a power of ten that is a double, hence rounded once, correctly (Clinger, How to
  // read floating point numbers accurately, 1990). Returns null, and no value, for any other word.
  const char* short_decimal(double& value) const {
    static constexpr std::array<double, 16> kPowers = {
        1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15};
    const char* p = at_;
    const bool negative = p != end_ && *p == '-';
    p += negative;
    std::uint64_t digits = 0;
    const char* const first = p;
    for (; p != end_ && *p >= '0' && *p <= '9'; ++p) digits = digits * 10 + (*p - '0');
    std::ptrdiff_t count = p - first, decimals = 0;
    if (p != end_ && *p == '.') {
      const char* const point = p;
      for (++p; p != end_ && *p >= '0' && *p <= '9'; ++p) digits = digits * 10 + (*p - '0');
      decimals = p - point - 1;
      count += decimals;
    }
    if (count == 0 || count > 15 || (p != end_ && !is_space(*p))) return nullptr;
    const double magnitude = static_cast<double>(digits) / kPowers[decimals];
    value = negative ? -magnitude : magnitude;
    return p;
  }

  void skip_blanks() {
    while (at_ != end_ && is_space(*at_)) ++at_;
    if (at_ != end_ && *at_ == '#') {
      comment_ = {at_ + 1, end_};
      at_ = end_;
    }
  }

  const char* at_;
  const char* end_;
  std::string_view comment_;
  std::size_t size_;
  std::int64_t number_;
};

template <class Visit>
void for_each_line(std::string_view text, Visit visit) {
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);  // byte order mark
  std::int64_t number = 0;
  while (!text.empty()) {
    const std::size_t end = text.find('\n');
    Line line(text.substr(0, end), ++number);
    if (!line.done()) visit(line);
    if (end == std::string_view::npos) break;
    text.remove_prefix(end + 1);
  }
}

// The text after "NAME:" in a comment, without blanks around it; empty if there is none.
inline std::string_view text_after(std::string_view name, std::string_view comment) {
  const auto trim = [&] {
    while (!comment.empty() && is_space(comment.front())) comment.remove_prefix(1);
    while (!comment.empty() && is_space(comment.back())) comment.remove_suffix(1);
  };
  trim();
  if (!comment.starts_with(name)) return {};
  comment.remove_prefix(name.size());
  if (!comment.starts_with(':')) return {};
  comment.remove_prefix(1);
  trim();
  return comment;
}

inline std::string quoted(std::string_view word) {
  std::string out = "'";
  for (const char c : word.substr(0, 40)) out += (c >= ' ' && c <= '~') ? c : '?';
  return out + (word.size() > 40 ? "...'" : "'");
}

}  // namespace masat
