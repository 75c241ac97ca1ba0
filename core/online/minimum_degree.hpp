// The order in which some nodes of a graph are eliminated after all others.
// Amestoy, Davis, Duff, "An approximate minimum degree ordering algorithm", SIMAX 1996.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace masat {

// Orders variables 0, 1, ..., of which `last` at the end keep their order and come last. What has
// been eliminated before enters as elements: sets of variables that it joins to each other.
class MinimumDegree {
 public:
  void start(std::int32_t variables, std::int32_t last);
  void add_element(std::span<const std::int32_t> variables);
  void add_pair(std::int32_t a, std::int32_t b);
  void order();

  // Variables that are eliminated together, since they have the same neighbors then. Groups are in
  // the order of the elimination, so a group's parent comes after it.
  struct Group {
    std::int32_t first, pivots;  // in `eliminated()`
    std::int64_t row_begin;      // of the variables that are joined by the elimination
    std::int32_t rows;
    std::int32_t parent;  // the first group that eliminates one of the rows, or -1
  };
  std::span<const Group> groups() const { return groups_; }
  std::span<const std::int32_t> eliminated() const { return eliminated_; }
  std::span<const std::int32_t> rows(const Group& g) const {
    return {members_.data() + g.row_begin, static_cast<std::size_t>(g.rows)};
  }
  // The first group that eliminates a variable of an element.
  std::int32_t parent_of_element(std::int32_t e) const { return absorbed_by_[e]; }

 private:
  struct Variable {
    std::int64_t begin;  // of its list: elements, then neighbors that no element covers
    std::int32_t elements, neighbors;
    std::int32_t degree;
    std::int32_t next, previous;  // of the same degree
    bool eliminated;
  };

  void build_lists();
  void eliminate(std::int32_t pivot);
  void join(std::int32_t variable);
  bool update(std::int32_t variable, std::int32_t element);
  void insert(std::int32_t variable);
  void remove(std::int32_t variable);

  std::int32_t variables_ = 0, free_ = 0, initial_ = 0, lowest_ = 0;
  std::vector<std::int32_t> members_;  // of the elements
  std::vector<std::int64_t> element_begin_;
  std::vector<std::int32_t> element_size_, absorbed_by_;
  std::vector<std::int64_t>
      outside_;  // members of an element that the current pivot is not joined to
  std::vector<std::int32_t> pairs_, list_, covered_;
  std::vector<Variable> variable_;
  std::vector<std::int64_t> mark_;
  std::vector<std::int32_t> head_, tail_;  // of the variables of each degree
  std::vector<std::int32_t> eliminated_;
  std::vector<Group> groups_;
  std::int64_t stamp_ = 0, outside_stamp_ = 0;
};

}  // namespace masat
