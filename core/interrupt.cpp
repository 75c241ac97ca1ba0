#include "interrupt.hpp"

#include <atomic>
#include <chrono>

namespace masat {
namespace {

std::atomic<void (*)()> interrupt_check{nullptr};

}  // namespace

void set_interrupt_check(void (*check)()) { interrupt_check = check; }

void check_interrupt() {
  using Clock = std::chrono::steady_clock;
  constexpr auto kPause = std::chrono::milliseconds(50);
  thread_local Clock::time_point last{};
  const Clock::time_point now = Clock::now();
  if (now - last < kPause) return;
  last = now;
  if (void (*const check)() = interrupt_check) check();
}

}  // namespace masat
