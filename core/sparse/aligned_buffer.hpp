// Uninitialized memory for vectors of any width.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#ifdef __linux__
#include <sys/mman.h>
#endif

namespace masat {

class AlignedBuffer {
 public:
  AlignedBuffer() = default;
  explicit AlignedBuffer(std::int64_t doubles) {
    constexpr std::size_t kLine = 64, kHugePage = std::size_t{1} << 21;
    const std::size_t bytes = static_cast<std::size_t>(doubles) * sizeof(double);
    const std::size_t alignment = bytes >= kHugePage ? kHugePage : kLine;
    const std::size_t whole = (bytes + alignment) / alignment * alignment;
    data_ = {static_cast<double*>(::operator new(whole, std::align_val_t{alignment})),
             Free{std::align_val_t{alignment}}};
#ifdef __linux__
    if (alignment == kHugePage) madvise(data_.get(), whole, MADV_HUGEPAGE);
#endif
  }
  double* data() const { return data_.get(); }

 private:
  struct Free {
    std::align_val_t alignment;
    void operator()(double* p) const { ::operator delete(p, alignment); }
  };
  std::unique_ptr<double, Free> data_;
};

}  // namespace masat
