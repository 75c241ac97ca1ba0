// A queue of nodes by the information about them.
#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

namespace masat {

// The node with most information comes first. Nodes in the same class count as equal, and the one
// that reached the class first comes first. A class spans a sixteenth of a power of two: its number
// is given by the leading bits of a float. Each operation takes constant time.
class InformationQueue {
 public:
  struct Entry {
    std::int32_t node;  // -1: the queue is empty
    float information;
  };

  InformationQueue(std::int32_t nodes, std::size_t additions)
      : information_(nodes, 0), last_(kClasses) {
    links_.reserve(kClasses + additions);
    links_.resize(kClasses, {-1, -1});
    std::iota(last_.begin(), last_.end(), 0);
  }

  // Adds information about a node that has not been taken. Sums lie in [2^-32, 2^32).
  void add(std::int32_t node, float information) {
    float& sum = information_[node];
    const std::uint32_t before = class_of(sum);
    sum += information;
    const std::uint32_t now = class_of(sum);
    if (now == before) return;
    const auto link = static_cast<std::int32_t>(links_.size());
    links_.push_back({node, -1});
    links_[last_[now]].next = link;
    last_[now] = link;
    full_[now / kWord] |= std::uint64_t{1} << now % kWord;
    words_ |= std::uint64_t{1} << now / kWord;
  }

  Entry take() {
    while (words_ != 0) {
      const std::uint32_t word = kWord - 1 - std::countl_zero(words_);
      const std::uint32_t top = word * kWord + kWord - 1 - std::countl_zero(full_[word]);
      const Link first = links_[links_[top].next];
      links_[top].next = first.next;
      if (first.next < 0) {
        last_[top] = static_cast<std::int32_t>(top);
        full_[word] &= ~(std::uint64_t{1} << top % kWord);
        if (full_[word] == 0) words_ &= ~(std::uint64_t{1} << word);
      }
      // Otherwise this is an old entry: the node was taken already, or has moved to a higher class.
      const float sum = information_[first.node];
      if (class_of(sum) != top) continue;
      retire(first.node);
      return {first.node, sum};
    }
    return {-1, 0};
  }

  // Removes a node for good.
  void retire(std::int32_t node) { information_[node] = kRetired; }
  bool retired(std::int32_t node) const { return std::signbit(information_[node]); }

 private:
  struct Link {
    std::int32_t node, next;
  };
  static constexpr float kRetired = -1;
  static constexpr std::uint32_t kMantissaBits = 4, kClasses = 64 << kMantissaBits, kWord = 64;
  static std::uint32_t class_of(float x) {  // kClasses or more: of 0 and kRetired
    const std::uint32_t least = std::bit_cast<std::uint32_t>(0x1p-32f);
    return (std::bit_cast<std::uint32_t>(x) >> (23 - kMantissaBits)) -
           (least >> (23 - kMantissaBits));
  }

  std::vector<float> information_;
  std::vector<Link> links_;         // the first kClasses are heads of the lists
  std::vector<std::int32_t> last_;  // of each class's list
  std::uint64_t full_[kClasses / kWord] = {}, words_ = 0;  // classes, and words of them, in use
};

}  // namespace masat
