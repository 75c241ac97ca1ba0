// Ctrl-C during long computations.
#pragma once

namespace masat {

// Throws the exception of a signal that waits to be handled: KeyboardInterrupt for Ctrl-C. Only
// the thread that Python called may call this, with or without the interpreter lock, and not inside
// a task of a WorkerPool unless the task catches the exception. Cheap: most calls only read the
// clock, since the interpreter is asked at most every 50 ms.
void check_interrupt();

// The bindings say how to ask the interpreter. Until then no signal is noticed.
void set_interrupt_check(void (*check)());

// For loops with steps too short for a look at the clock: checks once per million operations.
class InterruptPoll {
 public:
  void add(double operations) {
    if ((operations_ += operations) < kInterval) return;
    operations_ = 0;
    check_interrupt();
  }

 private:
  static constexpr double kInterval = 1e6;  // well below a millisecond
  double operations_ = 0;
};

}  // namespace masat
