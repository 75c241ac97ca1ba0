#include <unordered_map>

#include "text/line.hpp"
#include "text/records.hpp"

namespace masat {

std::vector<std::pair<std::string, std::int64_t>> count_tags(std::string_view text) {
  std::vector<std::pair<std::string, std::int64_t>> counts;
  std::unordered_map<std::string, std::size_t> index;
  std::string tag;
  std::size_t last = 0;
  for_each_line(text, [&](Line& line) {
    if (starts_number(line.peek())) {
      int columns = 0;
      for (; !line.done(); ++columns) line.word();
      tag = std::to_string(columns) + " columns";
    } else {
      tag = line.word();
    }
    if (last == counts.size() || counts[last].first != tag) {
      last = index.try_emplace(tag, counts.size()).first->second;
      if (last == counts.size()) counts.emplace_back(tag, 0);
    }
    ++counts[last].second;
  });
  return counts;
}

}  // namespace masat
