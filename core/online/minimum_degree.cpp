#include "online/minimum_degree.hpp"

#include <algorithm>

namespace masat {

void MinimumDegree::start(std::int32_t variables, std::int32_t last) {
  variables_ = variables;
  free_ = variables - std::min(last, variables);
  members_.clear();
  element_begin_.clear();
  element_size_.clear();
  pairs_.clear();
}

void MinimumDegree::add_element(std::span<const std::int32_t> variables) {
  element_begin_.push_back(static_cast<std::int64_t>(members_.size()));
  element_size_.push_back(static_cast<std::int32_t>(variables.size()));
  members_.insert(members_.end(), variables.begin(), variables.end());
}

void MinimumDegree::add_pair(std::int32_t a, std::int32_t b) {
  pairs_.push_back(a);
  pairs_.push_back(b);
}

void MinimumDegree::order() {
  initial_ = static_cast<std::int32_t>(element_begin_.size());
  absorbed_by_.assign(initial_, -1);
  outside_.assign(initial_, 0);
  outside_stamp_ = 0;
  groups_.clear();
  eliminated_.clear();
  head_.assign(variables_ + 1, -1);
  tail_.assign(variables_ + 1, -1);
  lowest_ = 0;
  build_lists();
  for (std::int32_t v = 0; v < free_; ++v) insert(v);
  std::int32_t left = free_;
  while (left > 0) {
    while (head_[lowest_] < 0) ++lowest_;
    const std::int32_t pivot = head_[lowest_];
    remove(pivot);
    eliminate(pivot);
    left -= groups_.back().pivots;
  }
  for (std::int32_t v = free_; v < variables_; ++v) eliminate(v);
}

void MinimumDegree::build_lists() {
  variable_.assign(variables_, Variable{});
  for (const std::int32_t v : members_) ++variable_[v].elements;
  for (const std::int32_t v : pairs_) ++variable_[v].neighbors;
  std::int64_t begin = 0;
  for (Variable& v : variable_) {
    v.begin = begin;
    begin += v.elements + v.neighbors;
    v.elements = v.neighbors = 0;
  }
  list_.resize(begin);
  for (std::int32_t e = 0; e < initial_; ++e) {
    const std::int32_t* const first = members_.data() + element_begin_[e];
    for (std::int32_t k = 0; k < element_size_[e]; ++k) {
      Variable& v = variable_[first[k]];
      list_[v.begin + v.elements++] = e;
      v.degree += element_size_[e] - 1;
    }
  }
  for (std::size_t k = 0; k < pairs_.size(); ++k) {
    Variable& v = variable_[pairs_[k]];
    list_[v.begin + v.elements + v.neighbors++] = pairs_[k ^ 1];
  }
  // A pair may have been given more than once.
  if (mark_.size() < static_cast<std::size_t>(variables_)) mark_.resize(variables_, 0);
  for (Variable& v : variable_) {
    ++stamp_;
    std::int32_t* const first = list_.data() + v.begin + v.elements;
    std::int32_t kept = 0;
    for (std::int32_t k = 0; k < v.neighbors; ++k) {
      if (mark_[first[k]] == stamp_) continue;
      mark_[first[k]] = stamp_;
      first[kept++] = first[k];
    }
    v.neighbors = kept;
    v.degree = std::min(v.degree + kept, variables_ - 1);
  }
}

// Those of one degree are taken in the order of their insertion, which keeps the tree low.
void MinimumDegree::insert(std::int32_t v) {
  const std::int32_t degree = variable_[v].degree;
  variable_[v].next = -1;
  variable_[v].previous = tail_[degree];
  (tail_[degree] >= 0 ? variable_[tail_[degree]].next : head_[degree]) = v;
  tail_[degree] = v;
  lowest_ = std::min(lowest_, degree);
}

void MinimumDegree::remove(std::int32_t v) {
  const Variable& own = variable_[v];
  (own.previous >= 0 ? variable_[own.previous].next : head_[own.degree]) = own.next;
  (own.next >= 0 ? variable_[own.next].previous : tail_[own.degree]) = own.previous;
}

// Adds a variable to the element that is being made.
void MinimumDegree::join(std::int32_t v) {
  if (mark_[v] == stamp_) return;
  mark_[v] = stamp_;
  members_.push_back(v);
}

void MinimumDegree::eliminate(std::int32_t pivot) {
  const auto group = static_cast<std::int32_t>(groups_.size());
  const std::int32_t element = initial_ + group;
  const auto begin = static_cast<std::int64_t>(members_.size());
  const auto first = static_cast<std::int32_t>(eliminated_.size());
  eliminated_.push_back(pivot);
  Variable& own = variable_[pivot];
  own.eliminated = true;
  mark_[pivot] = ++stamp_;
  for (std::int64_t k = own.begin; k < own.begin + own.elements; ++k) {
    const std::int32_t e = list_[k];
    absorbed_by_[e] = group;
    for (std::int32_t m = 0; m < element_size_[e]; ++m) join(members_[element_begin_[e] + m]);
  }
  for (std::int64_t k = 0; k < own.neighbors; ++k) join(list_[own.begin + own.elements + k]);

  // Counts the members of each other element that the pivot is not joined to.
  outside_stamp_ += variables_ + 1;
  const auto end = static_cast<std::int64_t>(members_.size());
  for (std::int64_t k = begin; k < end; ++k) {
    const Variable& v = variable_[members_[k]];
    for (std::int64_t m = v.begin; m < v.begin + v.elements; ++m) {
      const std::int32_t e = list_[m];
      if (absorbed_by_[e] >= 0) continue;
      if (outside_[e] < outside_stamp_) outside_[e] = outside_stamp_ + element_size_[e];
      --outside_[e];
    }
  }
  std::int64_t kept = begin;
  for (std::int64_t k = begin; k < end; ++k) {
    const std::int32_t v = members_[k];
    if (v < free_) remove(v);
    if (update(v, element)) {
      members_[kept++] = v;
    } else {
      variable_[v].eliminated = true;
      eliminated_.push_back(v);
    }
  }
  members_.resize(kept);
  const auto rows = static_cast<std::int32_t>(kept - begin);
  element_begin_.push_back(begin);
  element_size_.push_back(rows);
  absorbed_by_.push_back(-1);
  outside_.push_back(0);
  const auto pivots = static_cast<std::int32_t>(eliminated_.size()) - first;
  groups_.push_back({first, pivots, begin, rows, -1});
  const auto left = variables_ - static_cast<std::int32_t>(eliminated_.size());
  for (std::int64_t k = begin; k < kept; ++k) {
    Variable& v = variable_[members_[k]];
    v.degree = std::min(v.degree + rows - 1, left - 1);
    if (members_[k] < free_) insert(members_[k]);
  }
  if (group > 0) {
    for (std::int64_t k = own.begin; k < own.begin + own.elements; ++k) {
      if (list_[k] >= initial_) groups_[list_[k] - initial_].parent = group;
    }
  }
}

// Brings the lists of a variable up to date after the elimination of a pivot that joins it to the
// new element; its degree becomes the number of neighbors outside of that. Returns false if there
// are none, so that it can be eliminated with the pivot.
bool MinimumDegree::update(std::int32_t variable, std::int32_t element) {
  Variable& v = variable_[variable];
  std::int32_t* const list = list_.data() + v.begin;
  covered_.assign(list + v.elements, list + v.elements + v.neighbors);
  std::int64_t degree = 0;
  std::int32_t kept = 0;
  for (std::int32_t k = 0; k < v.elements; ++k) {
    if (absorbed_by_[list[k]] >= 0) continue;
    degree += outside_[list[k]] - outside_stamp_;
    list[kept++] = list[k];
  }
  const std::int32_t others = kept;
  list[kept++] = element;
  v.elements = kept;
  v.neighbors = 0;
  for (const std::int32_t neighbor : covered_) {
    if (mark_[neighbor] == stamp_) continue;
    list[v.elements + v.neighbors++] = neighbor;
  }
  degree += v.neighbors;
  v.degree = static_cast<std::int32_t>(std::min<std::int64_t>(degree, variables_ - 1));
  return others > 0 || v.neighbors > 0 || variable >= free_;
}

}  // namespace masat
