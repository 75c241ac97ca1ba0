// The Python face of the core, described for readers in src/masat/_core.pyi.
#include <nanobind/nanobind.h>

#include "bindings/bindings.hpp"

NB_MODULE(_core, m) {
  using namespace masat;

  // Tables of records live as long as the interpreter: no leak to warn of.
  nb::set_leak_warnings(false);

  bind_lie(m);
  bind_graph(m);
  bind_systems(m);
  bind_relaxation(m);
  bind_equations(m);
  bind_text(m);
}
