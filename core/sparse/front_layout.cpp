#include "sparse/front_layout.hpp"

namespace masat {
FrontLayout::FrontLayout(const BlockPattern& pattern, const BlockGraph& graph,
                         const EliminationTree& tree, int block_size, int lanes)
    : block_size_(block_size),
      tree_(build_assembly_tree(graph, tree, block_size)),
      children_(tree_.parent) {
  lay_out_fronts(lanes);
  find_runs();
  lay_out_entries(pattern, graph);
}

void FrontLayout::lay_out_fronts(int lanes) {
  factor_start_.assign(1, 0);
  for (std::int32_t f = 0; f < fronts(); ++f) {
    FrontShape shape;
    shape.pivots = tree_.pivots(f) * block_size_;
    shape.rows = static_cast<std::int32_t>(tree_.rows(f).size()) * block_size_;
    shape.ld11 = leading_dimension(shape.pivots, lanes);
    shape.ld21 = leading_dimension(shape.rows, lanes);
    shape_.push_back(shape);
    const std::int64_t size = (shape.ld11 + shape.ld21) * shape.pivots;
    factor_start_.push_back(factor_start_.back() + (size + 7) / 8 * 8);
  }
}

void FrontLayout::find_runs() {
  run_start_.assign(1, 0);
  for (std::int32_t f = 0; f < fronts(); ++f) {
    const std::int32_t p = tree_.parent[f];
    if (p >= 0) {
      const std::int32_t pivots = tree_.pivots(p), first = tree_.first[p];
      const std::span<const std::int32_t> rows = tree_.rows(f), parent_rows = tree_.rows(p);
      std::int32_t next = 0;  // of the parent's rows
      for (std::size_t i = 0; i < rows.size(); ++i) {
        std::int32_t target = rows[i] - first;
        if (target >= pivots) {
          while (parent_rows[next] != rows[i]) ++next;
          target = pivots + next;
        }
        const auto source = static_cast<std::int32_t>(i) * block_size_;
        target *= block_size_;
        const bool continues = i > 0 && runs_.back().target + runs_.back().length == target &&
                               target != pivots * block_size_;
        if (continues) {
          runs_.back().length += block_size_;
        } else {
          runs_.push_back({source, target, block_size_});
        }
      }
    }
    run_start_.push_back(static_cast<std::int64_t>(runs_.size()));
  }
}

void FrontLayout::lay_out_entries(const BlockPattern& pattern, const BlockGraph& graph) {
  const std::int32_t n = pattern.columns();
  std::vector<std::int32_t> row_of(n);  // of each index, in the current front
  entry_start_.assign(1, 0);
  entries_.reserve(pattern.row.size());
  for (std::int32_t f = 0; f < fronts(); ++f) {
    const FrontShape& front = shape_[f];
    const std::int64_t below = l11_size(f);
    const std::span<const std::int32_t> rows = tree_.rows(f);
    for (std::size_t i = 0; i < rows.size(); ++i) row_of[rows[i]] = static_cast<std::int32_t>(i);
    for (std::int32_t k = tree_.first[f]; k < tree_.first[f + 1]; ++k) {
      const std::int32_t node = tree_.order[k];
      const std::int64_t pivot = std::int64_t{k - tree_.first[f]} * block_size_;
      entries_.push_back(
          {pivot * (front.ld11 + 1), static_cast<std::int32_t>(pattern.start[node]), false, false});
      for (const BlockGraph::Neighbor& neighbor : graph.neighbors(node)) {
        const std::int32_t row = tree_.index[neighbor.node];
        if (row < k) continue;
        const bool eliminated = row < tree_.first[f + 1];
        const std::int64_t target =
            eliminated ? pivot * front.ld11 + std::int64_t{row - tree_.first[f]} * block_size_
                       : below + pivot * front.ld21 + std::int64_t{row_of[row]} * block_size_;
        entries_.push_back({target, neighbor.entry, !eliminated, neighbor.node < node});
      }
      entry_start_.push_back(static_cast<std::int64_t>(entries_.size()));
    }
  }
}

}  // namespace masat
