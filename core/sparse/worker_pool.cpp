#include "sparse/worker_pool.hpp"

#include <system_error>

namespace masat {
namespace {

// Waits for another thread: spins for some ten microseconds, then leaves the core to others.
class Backoff {
 public:
  bool is_spinning() const { return spins_ <= kSpins; }
  void pause() {
    if (++spins_ > kSpins) {
      std::this_thread::yield();
    } else {
#if defined(__x86_64__)
      __builtin_ia32_pause();
#elif defined(__aarch64__)
      asm volatile("yield");
#endif
    }
  }

 private:
  static constexpr int kSpins = 2000;
  int spins_ = 0;
};

}  // namespace

WorkerPool::WorkerPool(int threads) {
  try {
    for (int rank = 1; rank < threads; ++rank) workers_.emplace_back(&WorkerPool::work, this, rank);
  } catch (const std::system_error&) {
    // The system has no more threads: those that were started suffice.
  }
}

WorkerPool::~WorkerPool() {
  stop_.store(true, std::memory_order_relaxed);
  advance_round();
  for (std::thread& worker : workers_) worker.join();
}

void WorkerPool::advance_round() {
  if (workers_.empty()) return;
  round_.fetch_add(1, std::memory_order_release);
  round_.notify_all();
}

void WorkerPool::share(std::int32_t count, Function function, void* context) {
  count_.store(count, std::memory_order_relaxed);
  function_.store(function, std::memory_order_relaxed);
  context_.store(context, std::memory_order_relaxed);
  done_.store(0, std::memory_order_relaxed);
  const std::uint64_t step = (ticket_.load(std::memory_order_relaxed) >> 32) + 1;
  ticket_.store(step << 32 | static_cast<std::uint32_t>(count), std::memory_order_release);
  while (work_on_task(0)) {
  }
  for (Backoff backoff; done_.load(std::memory_order_acquire) != count;) backoff.pause();
}

bool WorkerPool::work_on_task(int rank) {
  std::uint64_t ticket = ticket_.load(std::memory_order_acquire);
  while (static_cast<std::uint32_t>(ticket) != 0) {
    const std::int32_t count = count_.load(std::memory_order_relaxed);
    const Function function = function_.load(std::memory_order_relaxed);
    void* const context = context_.load(std::memory_order_relaxed);
    if (ticket_.compare_exchange_weak(ticket, ticket - 1, std::memory_order_acq_rel,
                                      std::memory_order_acquire)) {
      function(context, count - static_cast<std::int32_t>(ticket), rank);
      done_.fetch_add(1, std::memory_order_release);
      return true;
    }
  }
  return false;
}

void WorkerPool::work(int rank) {
  for (std::uint32_t asleep = 0;;) {
    // The steps of an iteration follow each other sooner than a thread wakes.
    for (Backoff backoff; backoff.is_spinning() && round_.load(std::memory_order_relaxed) == asleep;
         backoff.pause()) {
    }
    round_.wait(asleep, std::memory_order_acquire);
    std::uint32_t round = round_.load(std::memory_order_acquire);
    for (Backoff backoff; round % 2 == 1; round = round_.load(std::memory_order_acquire)) {
      if (stop_.load(std::memory_order_relaxed)) return;
      if (work_on_task(rank)) {
        backoff = {};
      } else {
        backoff.pause();
      }
    }
    asleep = round;
  }
}

}  // namespace masat
