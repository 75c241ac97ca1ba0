#include "online/memory_pool.hpp"

#include <algorithm>
#include <bit>

namespace masat {
namespace {

constexpr std::int64_t kUnit = 8;          // doubles of a cache line, to which blocks are aligned
constexpr std::int64_t kSlab = 1ll << 14;  // doubles that are obtained at once for small blocks

// The sizes 4, 5, 6, 7 units times a power of two.
std::int32_t class_of(std::int64_t doubles) {
  const auto units = static_cast<std::uint64_t>(std::max<std::int64_t>((doubles + kUnit - 1) / kUnit, 4));
  const int octave = std::bit_width(units) - 3;
  const std::uint64_t quarters = (units + (std::uint64_t{1} << octave) - 1) >> octave;  // 4 to 8
  return static_cast<std::int32_t>(4 * octave + static_cast<int>(quarters) - 4);
}

std::int64_t size_of(std::int32_t size_class) {
  return kUnit * (std::int64_t{4 + size_class % 4} << (size_class / 4));
}

}  // namespace

MemoryPool::Block MemoryPool::take(std::int64_t doubles) {
  const std::int32_t size_class = class_of(doubles);
  if (static_cast<std::size_t>(size_class) >= classes_.size()) classes_.resize(size_class + 1);
  Class& own = classes_[size_class];
  if (own.unused.empty()) grow(own, size_of(size_class));
  Block block{own.unused.back(), size_class};
  own.unused.pop_back();
  return block;
}

void MemoryPool::give_back(Block& block) {
  if (block.data == nullptr) return;
  classes_[block.size_class].unused.push_back(block.data);
  block = {};
}

void MemoryPool::grow(Class& of, std::int64_t doubles) {
  const std::int64_t count = std::max<std::int64_t>(1, kSlab / doubles);
  of.owned.emplace_back(count * doubles);
  bytes_ += count * doubles * static_cast<std::int64_t>(sizeof(double));
  for (std::int64_t k = count - 1; k >= 0; --k) {
    of.unused.push_back(of.owned.back().data() + k * doubles);
  }
}

}  // namespace masat
