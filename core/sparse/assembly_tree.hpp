// The fronts of a multifrontal factorization and their tree.
// Duff, Reid, "The multifrontal solution of indefinite sparse symmetric linear equations",
// TOMS 1983; Liu, "The multifrontal method for sparse matrix solution", SIAM Review 1992.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sparse/block_pattern.hpp"
#include "sparse/elimination_tree.hpp"

namespace masat {

// Front f eliminates the nodes order[first[f]], ..., order[first[f + 1] - 1] and updates the rows
// below them. Fronts are postordered; rows are indices into `order`, ascending.
struct AssemblyTree {
  std::vector<std::int32_t> order, index;  // the nodes by index, and the inverse
  std::vector<std::int32_t> first;         // of each front, and the end
  std::vector<std::int32_t> parent;        // -1 at a root
  std::vector<std::int64_t> row_start;
  std::vector<std::int32_t> row;
  std::int32_t boundary = 0;          // nodes that are not eliminated: those of the last front
  std::vector<std::int32_t> element;  // which element each front is, or -1

  std::int32_t fronts() const { return static_cast<std::int32_t>(parent.size()); }
  bool is_boundary(std::int32_t f) const { return boundary > 0 && f == fronts() - 1; }
  bool is_eliminated(std::int32_t f) const { return element[f] < 0 && !is_boundary(f); }
  std::int32_t pivots(std::int32_t f) const { return first[f + 1] - first[f]; }
  std::span<const std::int32_t> rows(std::int32_t f) const {
    return {row.data() + row_start[f], row.data() + row_start[f + 1]};
  }
};

AssemblyTree build_assembly_tree(const BlockGraph& graph, const EliminationTree& tree,
                                 int block_size);

}  // namespace masat
