// Threads that share the steps of a computation.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <thread>
#include <type_traits>
#include <vector>

namespace masat {

// The calling thread publishes each step and works on it; the other threads take tasks as they find
// them. A step waits for its tasks only, never for a thread that has not begun to work on it.
class WorkerPool {
 public:
  explicit WorkerPool(int threads);
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  int threads() const { return static_cast<int>(workers_.size()) + 1; }

  // Keeps the workers awake while it lives. Without one they sleep, and the caller does all tasks.
  // Within another one it does nothing.
  class Session {
   public:
    explicit Session(WorkerPool& pool) : pool_(pool) {
      if (pool_.sessions_++ == 0) pool_.advance_round();
    }
    ~Session() {
      if (--pool_.sessions_ == 0) pool_.advance_round();
    }
    Session(const Session&) = delete;
    Session& operator=(const Session&) = delete;

   private:
    WorkerPool& pool_;
  };

  // Calls f(index, rank) for each index below `count` on any of the threads, whose ranks count from
  // the caller's 0; returns when all calls are done. `f` must not throw.
  template <class F>
  void for_each(std::int32_t count, F&& f) {
    if (count == 1 || workers_.empty()) {
      for (std::int32_t i = 0; i < count; ++i) f(i, 0);
      return;
    }
    using Plain = std::remove_reference_t<F>;
    share(
        count,
        [](void* context, std::int32_t i, int rank) { (*static_cast<Plain*>(context))(i, rank); },
        &f);
  }

  // Calls f(begin, end) for chunks of `size` indices below `count`, the last of them shorter.
  template <class F>
  void for_chunks(std::int64_t count, std::int64_t size, F&& f) {
    for_each(static_cast<std::int32_t>((count + size - 1) / size),
             [&](std::int32_t i, int) { f(i * size, std::min((i + 1) * size, count)); });
  }

 private:
  using Function = void (*)(void* context, std::int32_t index, int rank);
  void share(std::int32_t count, Function function, void* context);
  bool work_on_task(int rank);
  void work(int rank);
  void advance_round();

  std::vector<std::thread> workers_;
  int sessions_ = 0;                     // of the calling thread
  std::atomic<std::uint32_t> round_{0};  // odd during a session and after the end
  std::atomic<bool> stop_{false};
  // The current step. The upper half of the ticket is its number, the lower half the count of tasks
  // that are not taken yet. Whoever takes one with the number unchanged has read the function,
  // context and count of the same step.
  alignas(64) std::atomic<std::uint64_t> ticket_{0};
  std::atomic<std::int32_t> count_{0};
  std::atomic<Function> function_{nullptr};
  std::atomic<void*> context_{nullptr};
  alignas(64) std::atomic<std::int32_t> done_{0};
};

// A pool of one thread, to be used within a task.
struct Solo {
  int rank;
  template <class F>
  void for_each(std::int32_t count, F&& f) const {
    for (std::int32_t i = 0; i < count; ++i) f(i, rank);
  }
};

}  // namespace masat
