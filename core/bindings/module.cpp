// The Python module of the core; src/masat/_core.pyi describes it.
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

  // Module-level tables of records live until the interpreter ends, which nanobind reports as
  // leaks.
  nb::set_leak_warnings(false);
  set_interrupt_check(&raise_pending_signal);

  bind_lie(m);
  bind_graph(m);
  bind_systems(m);
  bind_relaxation(m);
  bind_equations(m);
  bind_text(m);
  bind_online(m);
}
