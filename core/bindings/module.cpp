// The Python face of the core, described for readers in src/masat/_core.pyi.
#include <nanobind/nanobind.h>

#include "bindings/bindings.hpp"
#include "interrupt.hpp"

namespace {

// Runs the handlers of signals that arrived, in the main thread; in others it does nothing.
void raise_pending_signal() {
  const nanobind::gil_scoped_acquire acquire;
  if (PyErr_CheckSignals() != 0) throw nanobind::python_error();
}

}  // namespace

NB_MODULE(_core, m) {
  using namespace masat;

  // Tables of records live as long as the interpreter: no leak to warn of.
  nb::set_leak_warnings(false);
  set_interrupt_check(&raise_pending_signal);

  bind_lie(m);
  bind_graph(m);
  bind_systems(m);
  bind_relaxation(m);
  bind_equations(m);
  bind_text(m);
}
