// Memory of tensors, kept for the next one: a step makes the same tensors as the one before it, and what the system
// gives back and forth has to be cleared each time.

#include "shim.h"

#include <c10/core/Allocator.h>
#include <c10/core/CPUAllocator.h>
#include <c10/core/impl/alloc_cpu.h>
#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <mutex>
#include <vector>

namespace {

// Before each block stands its class, on a line of its own so that blocks are aligned as libtorch's are.
constexpr size_t kHead = 64;
// Blocks of scalars and the like are of one class: the system's own allocator cuts each aligned one out of a larger.
constexpr int kLeastPower = 6;
constexpr size_t kLeast = size_t{1} << kLeastPower;
// Four sizes between a power of two and the next: at most a fifth of a block is left over.
constexpr int kSteps = 4;
constexpr int kClasses = 46 * kSteps;

struct Size {
  int number;
  size_t bytes;
};

// The class that n bytes fit into.
Size class_of(size_t n) {
  n = std::max(n, kLeast);
  const int power = 63 - __builtin_clzll(n);
  const size_t step = (size_t{1} << power) / kSteps, base = size_t{1} << power;
  const size_t up = (n - base + step - 1) / step;
  const int number = (power - kLeastPower) * kSteps + static_cast<int>(up);
  return number < kClasses ? Size{number, base + up * step} : Size{-1, n};
}

class Kept final : public c10::Allocator {
 public:
  c10::DataPtr allocate(size_t n) override {
    void* block = n == 0 ? nullptr : take(n);
    return {block, block, &give, c10::Device(c10::DeviceType::CPU)};
  }
  c10::DeleterFnPtr raw_deleter() const override { return &give; }
  void copy_data(void* dest, const void* src, std::size_t count) const override { default_copy_data(dest, src, count); }

  // What is kept at most, in bytes.
  void bound(size_t bytes) { most_ = bytes; }

  // Never taken down: tensors of other libraries' globals outlive those of this one.
  static Kept& own() {
    static auto* kept = new Kept;
    return *kept;
  }

 private:
  struct Shelf {
    std::mutex mutex;
    std::vector<char*> blocks;
  };

  void* take(size_t n) {
    const auto size = class_of(n);
    char* base = nullptr;
    if (size.number >= 0) {
      auto& shelf = shelves_[size.number];
      std::lock_guard<std::mutex> lock(shelf.mutex);
      if (!shelf.blocks.empty()) {
        base = shelf.blocks.back();
        shelf.blocks.pop_back();
      }
    }
    if (base) {
      kept_ -= size.bytes;
    } else {
      base = fresh(size.bytes + kHead);
      *reinterpret_cast<int64_t*>(base) = size.number;
      *(reinterpret_cast<int64_t*>(base) + 1) = static_cast<int64_t>(size.bytes);
    }
    return base + kHead;
  }

  // Where there is no more memory, what is kept is given back first.
  char* fresh(size_t n) {
    try {
      return static_cast<char*>(c10::alloc_cpu(n));
    } catch (const c10::Error&) {
      empty();
      return static_cast<char*>(c10::alloc_cpu(n));
    }
  }

  static void give(void* block) {
    if (!block) return;
    char* base = static_cast<char*>(block) - kHead;
    const auto number = *reinterpret_cast<int64_t*>(base);
    const auto bytes = static_cast<size_t>(*(reinterpret_cast<int64_t*>(base) + 1));
    auto& all = own();
    if (number < 0 || bytes > all.most_) {
      c10::free_cpu(base);
      return;
    }
    // Sizes change from time to time: what is kept of former ones goes when there is too much.
    if (all.kept_ + bytes > all.most_) all.empty();
    all.kept_ += bytes;
    auto& shelf = all.shelves_[number];
    std::lock_guard<std::mutex> lock(shelf.mutex);
    shelf.blocks.push_back(base);
  }

  void empty() {
    for (auto& shelf : shelves_) {
      std::vector<char*> blocks;
      {
        std::lock_guard<std::mutex> lock(shelf.mutex);
        blocks.swap(shelf.blocks);
      }
      for (char* base : blocks) {
        kept_ -= static_cast<size_t>(*(reinterpret_cast<int64_t*>(base) + 1));
        c10::free_cpu(base);
      }
    }
  }

  std::array<Shelf, kClasses> shelves_;
  std::atomic<size_t> kept_{0};
  std::atomic<size_t> most_{0};
};

}  // namespace

extern "C" {

// Keeps up to so many bytes of freed tensors from now on.
int rl_keep_memory(size_t most) {
  return guarded([&] {
    Kept::own().bound(most);
    c10::SetCPUAllocator(&Kept::own(), 1);
  });
}

}  // extern "C"
