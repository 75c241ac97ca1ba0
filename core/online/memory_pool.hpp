// Memory of fronts that come and go.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "sparse/aligned_buffer.hpp"

namespace masat {

// Blocks of doubles, aligned for vectors of any width. A block that is returned is used again for
// the next one of its size class; there are four classes for each power of two.
class MemoryPool {
 public:
  struct Block {
    double* data = nullptr;
    std::int32_t size_class = -1;
  };

  Block take(std::int64_t doubles);
  void give_back(Block& block);
  // Bytes of all blocks, in use or not.
  std::int64_t bytes() const { return bytes_; }

 private:
  struct Class {
    std::vector<double*> unused;
    std::vector<AlignedBuffer> owned;
  };
  void grow(Class& of, std::int64_t doubles);

  std::vector<Class> classes_;
  std::int64_t bytes_ = 0;
};

}  // namespace masat
