// The Gauss-Newton system of a pose graph: H step = -gradient / 2, H = sum J' W J over the edges.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "graph/topology.hpp"
#include "sparse/graph_matrix.hpp"

namespace masat {

// What the optimizers see, whatever the group. Poses are flat arrays of all nodes, steps and
// gradients flat arrays of the free ones; chi2 is the sum of e' W e, without a factor 1/2.
class NormalEquations {
 public:
  virtual ~NormalEquations() = default;
  virtual int dof() const = 0;
  virtual int pose_size() const = 0;
  virtual std::int32_t nodes() const = 0;
  virtual std::int64_t edges() const = 0;
  virtual std::span<const std::int32_t> free_nodes() const = 0;

  virtual double chi2(const double* poses) = 0;
  virtual void edge_chi2(const double* poses, double* out) = 0;
  // Sets H and the gradient's negative half at `poses`; returns chi2 there. Weights, one an edge if
  // any, multiply the information.
  virtual double linearize(const double* poses, std::span<const double> weights) = 0;
  virtual std::span<const double> rhs() const = 0;
  virtual void diagonal(double* out) const = 0;
  virtual void multiply(const double* v, double* out) const = 0;  // H v
  // Factorizes H plus a diagonal; returns -1, or the node at which it is not positive definite.
  [[nodiscard]] virtual std::int32_t factorize(std::span<const double> damping) = 0;
  // The smallest ratio of a pivot to its diagonal entry of H plus the damping; 1 without unknowns.
  virtual double pivot_ratio() const = 0;
  virtual void solve(double* step) const = 0;
  // Blocks of the inverse of what was factorized, by places among the free nodes, each row-major.
  virtual void inverse(std::span<const std::int32_t> rows, std::span<const std::int32_t> columns,
                       double* out) const = 0;
  virtual void retract(const double* poses, const double* step, double* out) const = 0;
};

template <class Group>
class NormalEquationsOf final : public NormalEquations {
 public:
  static constexpr int kDof = Group::kDof, kSize = Group::kSize, kBlock = kDof * kDof;
  using Square = typename Group::Square;
  using Tangent = typename Group::Tangent;

  // Held nodes keep their poses and have no place in the system. The numbers do not depend on how
  // many threads factorize.
  NormalEquationsOf(const Topology& graph, std::shared_ptr<const Elimination> elimination,
                    const double* measurements, const double* information, int threads)
      : edges_(graph.edges()),
        poses_(graph.nodes()),
        matrix_(std::move(elimination), kDof, threads),
        rhs_(matrix_.rows()) {
    const auto m = static_cast<std::int64_t>(edges_.size());
    z_.reserve(m);
    const typename Group::Table z(measurements, m);
    information_.reserve(m);
    for (std::int64_t k = 0; k < m; ++k) {
      z_.push_back(z[k]);
      information_.push_back(Eigen::Map<const Square>(information + k * kBlock));
    }
  }

  int dof() const override { return kDof; }
  int pose_size() const override { return kSize; }
  std::int32_t nodes() const override { return elimination().nodes(); }
  std::int64_t edges() const override { return static_cast<std::int64_t>(edges_.size()); }
  std::span<const std::int32_t> free_nodes() const override { return elimination().free_nodes(); }
  std::span<const double> rhs() const override { return rhs_; }

  double chi2(const double* poses) override {
    load(poses);
    double sum = 0;
    for (std::size_t k = 0; k < edges_.size(); ++k) sum += edge_cost(k);
    return sum;
  }

  void edge_chi2(const double* poses, double* out) override {
    load(poses);
    for (std::size_t k = 0; k < edges_.size(); ++k) out[k] = edge_cost(k);
  }

  double linearize(const double* poses, std::span<const double> weights) override {
    load(poses);
    matrix_.set_zero();
    std::fill(rhs_.begin(), rhs_.end(), 0.0);
    double sum = 0;
    for (std::size_t k = 0; k < edges_.size(); ++k) {
      const Edge& edge = edges_[k];
      const std::int32_t a = elimination().place(edge.from), b = elimination().place(edge.to);
      Square ja, jb, weighted;
      const Tangent e = error(z_[k], poses_[edge.from], poses_[edge.to], ja, jb);
      const Square& w =
          weights.empty() ? information_[k] : (weighted = weights[k] * information_[k]);
      const Tangent we = w * e;
      sum += e.dot(we);
      if (a >= 0) {
        const Square wja = w * ja;
        block(matrix_.node_block(a)).noalias() += ja.transpose() * wja;
        segment(a).noalias() -= ja.transpose() * we;
        if (b >= 0) {
          if (a < b) {
            block(matrix_.joint_block(k)).noalias() += jb.transpose() * wja;
          } else {
            block(matrix_.joint_block(k)).noalias() += wja.transpose() * jb;
          }
        }
      }
      if (b >= 0) {
        block(matrix_.node_block(b)).noalias() += jb.transpose() * (w * jb);
        segment(b).noalias() -= jb.transpose() * we;
      }
    }
    return sum;
  }

  void diagonal(double* out) const override { matrix_.diagonal(out); }
  void multiply(const double* v, double* out) const override { matrix_.multiply(v, 1, out); }

  [[nodiscard]] std::int32_t factorize(std::span<const double> damping) override {
    const std::int32_t failed = matrix_.factorize(damping);
    return failed < 0 ? -1 : free_nodes()[failed];
  }

  double pivot_ratio() const override { return matrix_.pivot_ratio(); }

  void solve(double* step) const override {
    std::copy(rhs_.begin(), rhs_.end(), step);
    matrix_.solve({step, rhs_.size()});
  }

  void inverse(std::span<const std::int32_t> rows, std::span<const std::int32_t> columns,
               double* out) const override {
    matrix_.inverse(rows, columns, out);
  }

  void retract(const double* poses, const double* step, double* out) const override {
    for (std::int32_t node = 0; node < nodes(); ++node) {
      const double* const from = poses + std::int64_t{kSize} * node;
      double* const to = out + std::int64_t{kSize} * node;
      const std::int32_t f = elimination().place(node);
      if (f < 0) {
        std::copy(from, from + kSize, to);
      } else {
        (Group::load(from) * Group::from_tangent(step + std::int64_t{kDof} * f)).store(to);
      }
    }
  }

 private:
  const Elimination& elimination() const { return *matrix_.elimination(); }
  static Eigen::Map<Square> block(double* values) { return Eigen::Map<Square>(values); }
  Eigen::Map<Tangent> segment(std::int32_t f) {
    return Eigen::Map<Tangent>(&rhs_[std::int64_t{kDof} * f]);
  }

  void load(const double* poses) {
    const typename Group::Table table(poses, nodes());
    for (std::int32_t node = 0; node < nodes(); ++node) poses_[node] = table[node];
  }

  double edge_cost(std::size_t k) const {
    const Tangent e = error(z_[k], poses_[edges_[k].from], poses_[edges_[k].to]);
    return e.dot(information_[k] * e);
  }

  std::vector<Edge> edges_;
  std::vector<Group> z_;
  std::vector<Square> information_;
  std::vector<Group> poses_;
  GraphMatrix matrix_;
  std::vector<double> rhs_;
};

}  // namespace masat
