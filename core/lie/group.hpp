// What the algorithms ask of a group of poses: SE(2), SE(3), and any other that is to be added.
#pragma once

#include <concepts>
#include <cstdint>
#include <type_traits>

#include "lie/se2.hpp"
#include "lie/se3.hpp"

namespace masat {

// G{} is the identity, a * b the pose b given in the frame of a.
//
// kDimension     Dimension d of space.
// kSize          Numbers of a pose in an array, the translation first.
// kDof           Numbers of a tangent vector, the translation first.
// Tangent        Column vector of kDof numbers; Square is a matrix of as many rows and columns.
// Vector         Column vector of d numbers; Rotation is a matrix of as many rows and columns.
//
// load, store    Read and write the kSize numbers; what is stored is normalized.
// inverse        a.inverse() * a is the identity, up to rounding.
// rotation       The rotation matrix R, and translation() the vector t: a point p goes to R p + t.
// at             The same rotation with another translation.
// nearest        The pose at the origin whose rotation is nearest to a matrix.
// from_tangent   The step from the identity along a tangent vector, as in g2o.
//
// error(z, a, b) is the tangent vector from z to a^-1 b: error({}, {}, from_tangent(v)) is v, for a
// v that is small enough. With two matrices it also writes the derivatives at a * from_tangent(u)
// and b * from_tangent(v) with respect to u and v.
//
// step_at(o) is the derivative of o^-1 from_tangent(u) o, as a tangent vector, at u = 0.
//
// Table          Read-only view of an array of poses, which must outlive it or be replaced by
//                view(), without allocation if it had as many poses before. What many uses of a
//                pose share, prepare() computes once for a range of them, after view().
// Mean           Average of the poses given to the constructor and to add(): of one pose, itself.
// Turn           The rotation of a pose, of which operator() returns a fraction, at the origin.
template <class G>
concept LieGroup =
    std::copyable<G> && std::default_initializable<G> &&
    std::same_as<decltype(std::integral_constant<int, G::kDimension>::value), const int> &&
    std::same_as<decltype(std::integral_constant<int, G::kSize>::value), const int> &&
    std::same_as<decltype(std::integral_constant<int, G::kDof>::value), const int> &&
    G::Tangent::SizeAtCompileTime == G::kDof && G::Square::RowsAtCompileTime == G::kDof &&
    G::Square::ColsAtCompileTime == G::kDof && G::Vector::SizeAtCompileTime == G::kDimension &&
    G::Rotation::RowsAtCompileTime == G::kDimension &&
    G::Rotation::ColsAtCompileTime == G::kDimension &&
    requires(const G& a, const G& b, const double* in, double* out, std::int64_t count,
             const typename G::Vector& t, const typename G::Rotation& m,
             typename G::Square& jacobian, typename G::Table table, const typename G::Table& poses,
             typename G::Mean mean, const typename G::Turn& turn) {
      { G::load(in) } -> std::same_as<G>;
      a.store(out);
      { a * b } -> std::same_as<G>;
      { a.inverse() } -> std::same_as<G>;
      { a.rotation() } -> std::convertible_to<typename G::Rotation>;
      { a.translation() } -> std::convertible_to<typename G::Vector>;
      { a.at(t) } -> std::same_as<G>;
      { G::nearest(m) } -> std::same_as<G>;
      { G::from_tangent(in) } -> std::same_as<G>;
      { error(a, a, b) } -> std::same_as<typename G::Tangent>;
      { error(a, a, b, jacobian, jacobian) } -> std::same_as<typename G::Tangent>;
      { step_at(a) } -> std::same_as<typename G::Square>;
      table.view(in, count);
      table.prepare(count, count);
      { poses[count] } -> std::convertible_to<G>;
      mean.add(b);
      { mean.get() } -> std::same_as<G>;
      { turn(0.5) } -> std::same_as<G>;
    } &&
    std::default_initializable<typename G::Table> &&
    std::constructible_from<typename G::Table, const double*, std::int64_t> &&
    std::constructible_from<typename G::Mean, const G&> &&
    std::constructible_from<typename G::Turn, const G&>;

static_assert(LieGroup<SE2> && LieGroup<SE3>);

}  // namespace masat
