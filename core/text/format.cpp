#include <charconv>

#include "text/records.hpp"

namespace masat {

std::string format_lines(std::string_view tag, const std::int64_t* integers,
                         std::int64_t integer_columns, const double* values,
                         std::int64_t value_columns, std::int64_t rows,
                         const std::vector<std::string>& labels, std::string_view name) {
  std::string out;
  out.reserve(rows * (tag.size() + 8 * integer_columns + 12 * value_columns));
  char number[32];
  // to_chars writes a decimal point whatever the locale; of doubles it is in libstdc++ 11,
  // libc++ 14.
  const auto append = [&](auto value) {
    const auto [end, status] = std::to_chars(number, number + sizeof number, value);
    if (!out.empty() && out.back() != '\n') out += ' ';
    out.append(number, end);
  };
  for (std::int64_t row = 0; row < rows; ++row) {
    out += tag;
    for (std::int64_t c = 0; c < integer_columns; ++c) append(*integers++);
    for (std::int64_t c = 0; c < value_columns; ++c) append(*values++);
    if (!labels.empty()) ((out += " # ") += name) += ": " + labels[row];
    out += '\n';
  }
  return out;
}

}  // namespace masat
