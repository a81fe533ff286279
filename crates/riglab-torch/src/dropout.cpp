// Which activations dropout leaves: drawn in parallel, each by its place. libtorch draws them one after another by its
// Mersenne Twister on processors that are not Intel's.

#include "shim.h"

#include <ATen/ATen.h>
#include <ATen/CPUGeneratorImpl.h>
#include <ATen/Dispatch.h>
#include <ATen/Parallel.h>
#include <ATen/core/PhiloxRNGEngine.h>
#include <algorithm>
#include <cmath>
#include <mutex>

namespace {

// Elements that one engine draws for: its numbers have 32 bits, an element takes half of one.
constexpr int64_t kBlock = 1024;
// The fewest with which Philox4x32 passes all tests of TestU01 (Salmon et al. 2011).
constexpr int kRounds = 7;

}  // namespace

extern "C" {

// A new tensor like `x`: 0 with probability `p`, to 1 in 65,536, and 1 / (1 - p) otherwise. One number of the
// thread's generator is the key, so it goes on as after any draw; what it gives does not hang on the number of threads.
int rl_dropout_mask(const at::Tensor* x, double p, at::Tensor** out) {
  return guarded([&] {
    TORCH_CHECK(x->device().is_cpu() && p >= 0 && p < 1, "dropout of ", p, " on ", x->device());
    uint64_t key;
    {
      auto own = cpu_generator();
      auto* generator = at::check_generator<at::CPUGeneratorImpl>(own);
      std::lock_guard<std::mutex> lock(generator->mutex_);
      key = generator->random64();
    }
    auto mask = at::empty(x->sizes(), x->options().requires_grad(false));
    // Something is kept of any probability below 1.
    const auto dropped = std::min(static_cast<uint32_t>(std::lround(p * 65536)), 65535u);
    const int64_t n = mask.numel();
    AT_DISPATCH_FLOATING_TYPES_AND(at::kBFloat16, mask.scalar_type(), "dropout", [&] {
      auto* data = mask.data_ptr<scalar_t>();
      const scalar_t values[2] = {scalar_t(1 / (1 - p)), scalar_t(0)};
      at::parallel_for(0, (n + kBlock - 1) / kBlock, 4, [&](int64_t begin, int64_t end) {
        for (int64_t block = begin; block < end; ++block) {
          at::Philox4_32 engine(key, static_cast<uint64_t>(block), 0);
          const int64_t last = std::min(n, (block + 1) * kBlock);
          for (int64_t i = block * kBlock; i < last; i += 2) {
            const uint32_t bits = engine(kRounds);
            data[i] = values[(bits & 0xffff) < dropped];
            if (i + 1 < last) data[i + 1] = values[(bits >> 16) < dropped];
          }
        }
      });
    });
    *out = new at::Tensor(std::move(mask));
  });
}

}  // extern "C"
