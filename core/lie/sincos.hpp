// Sine and cosine together, without a branch, so that compilers vectorize loops over it.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <numbers>

namespace masat {

struct SinCos {
  double sin, cos;
};

// Below this, the reduction by multiples of pi/2 is exact to the last place.
constexpr double kReducible = 1e5;

// To about one unit in the last place, for |x| < kReducible. Minimax polynomials on
// [-pi/4, pi/4] and the split of pi/2 after Cody and Waite, both as in FDLIBM (Sun, 1993).
inline SinCos sincos_reducible(double x) {
  constexpr double kRound = 0x1.8p52;  // adding it leaves the nearest integer in the last bits
  const double shifted = x * (2 / std::numbers::pi) + kRound, q = shifted - kRound;
  const auto quadrant = std::bit_cast<std::int64_t>(shifted);
  const double r = ((x - q * 1.57079632673412561417e+00) - q * 6.07710050630396597660e-11) -
                   q * 2.02226624879595063154e-21;
  const double z = r * r, half = 0.5 * z, w = 1 - half;
  const double s =
      r + r * z *
              (-1.66666666666666324348e-01 +
               z * (8.33333333332248946124e-03 +
                    z * (-1.98412698298579493134e-04 +
                         z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 +
                                                                z * 1.58969099521155010221e-10)))));
  const double c =
      w +
      (((1 - w) - half) +
       z * z *
           (4.16666666666666019037e-02 +
            z * (-1.38888888888741095749e-03 +
                 z * (2.48015872894767294178e-05 +
                      z * (-2.75573143513906633035e-07 +
                           z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))))));
  // Odd quadrants swap the two; signs follow the quadrant's second bit.
  const bool swap = quadrant & 1;
  const double sine = swap ? c : s, cosine = swap ? s : c;
  const auto sign = static_cast<std::uint64_t>(quadrant & 2) << 62;
  const auto flip = static_cast<std::uint64_t>((quadrant + 1) & 2) << 62;
  return {std::bit_cast<double>(std::bit_cast<std::uint64_t>(sine) ^ sign),
          std::bit_cast<double>(std::bit_cast<std::uint64_t>(cosine) ^ flip)};
}

inline SinCos sincos(double x) {
  return std::abs(x) < kReducible ? sincos_reducible(x) : SinCos{std::sin(x), std::cos(x)};
}

// Of `count` angles, `stride` doubles apart; the same numbers as one by one, several at a time.
void sincos(const double* x, std::int64_t stride, std::int64_t count, SinCos* out);

}  // namespace masat
