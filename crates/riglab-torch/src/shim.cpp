// What tch does not reach: ops over tensor lists in place, autocast on the CPU, and settings of the
// global context. A tch tensor's pointer is an `at::Tensor*`. Each function returns 0, or 1 with the
// message kept for `rl_error`.

#include "shim.h"

#include <ATen/ATen.h>
#include <ATen/Context.h>
#include <ATen/autocast_mode.h>
#include <cmath>
#include <torch/headeronly/version.h>
#include <ATen/record_function.h>
#include <atomic>
#include <cstring>
#include <string>
#include <vector>

namespace {

std::vector<at::Tensor> list(at::Tensor* const* tensors, size_t n) {
  std::vector<at::Tensor> out;
  out.reserve(n);
  for (size_t i = 0; i < n; ++i) out.push_back(*tensors[i]);
  return out;
}

// Sums of f32 in double precision, several at a time.
double squares(const float* x, int64_t n) {
  constexpr int kLanes = 16;
  double sums[kLanes] = {0};
  int64_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
    for (int k = 0; k < kLanes; ++k) sums[k] += static_cast<double>(x[i + k]) * x[i + k];
  }
  for (int k = 0; i < n; ++i, ++k) sums[k] += static_cast<double>(x[i]) * x[i];
  double sum = 0;
  for (double s : sums) sum += s;
  return sum;
}

std::atomic<uint64_t> flops{0};

// What a GPU draws from, or the CPU for -1.
at::Generator generator_of(int gpu) {
  if (gpu < 0) return cpu_generator();
  return at::globalContext().defaultGenerator(c10::Device(c10::kCUDA, static_cast<c10::DeviceIndex>(gpu)));
}

// Shape of an input that is a tensor.
std::vector<int64_t> sizes(const at::RecordFunction& fn, size_t k) {
  const auto inputs = fn.inputs();
  if (k >= inputs.size() || !inputs[k].isTensor() || !inputs[k].toTensor().defined()) return {};
  return inputs[k].toTensor().sizes().vec();
}

// Operations of a product of [.., n, k] and [.., k, m].
uint64_t product(const std::vector<int64_t>& a, const std::vector<int64_t>& b) {
  if (a.size() < 2 || b.size() < 2) return 0;
  uint64_t count = 2 * static_cast<uint64_t>(b.back());
  for (int64_t n : a) count *= static_cast<uint64_t>(n);
  return count;
}

// Products of matrices are all ops of networks that count; what is made of them is seen as them.
std::unique_ptr<at::ObserverContext> count_flops(const at::RecordFunction& fn) {
  const std::string name = fn.name();
  uint64_t count = 0;
  if (name == "aten::mm" || name == "aten::bmm") {
    count = product(sizes(fn, 0), sizes(fn, 1));
  } else if (name == "aten::addmm" || name == "aten::baddbmm") {
    count = product(sizes(fn, 1), sizes(fn, 2));
  } else if (name == "mkldnn::_linear_pointwise") {
    const auto w = sizes(fn, 1);  // [m, k]
    if (w.size() == 2) count = product(sizes(fn, 0), {w[1], w[0]});
  } else if (name.rfind("aten::_scaled_dot_product_flash_attention", 0) == 0 ||
             name.rfind("aten::_scaled_dot_product_efficient_attention", 0) == 0) {
    // Scores and their mix are two products; backward there are five.
    const bool backward = name.find("backward") != std::string::npos;
    const auto q = sizes(fn, backward ? 1 : 0), k = sizes(fn, backward ? 2 : 1);
    if (q.size() == 4 && k.size() == 4) {
      count = (backward ? 10 : 4) * static_cast<uint64_t>(q[0] * q[1] * q[2]) * static_cast<uint64_t>(k[2] * q[3]);
    }
  }
  flops += count;
  return nullptr;
}

}  // namespace

extern "C" {

const char* rl_error() { return last_error.c_str(); }

// One step of AdamW over all parameters; the caller has counted `steps` up. `grad_scale`, if given,
// divides the gradients (a clip without a pass of its own).
int rl_fused_adamw(at::Tensor* const* params, at::Tensor* const* grads, at::Tensor* const* m, at::Tensor* const* v,
                   at::Tensor* const* steps, size_t n, double lr, double beta1, double beta2, double weight_decay,
                   double eps, at::Tensor* grad_scale) {
  return guarded([&] {
    at::NoGradGuard no_grad;
    std::optional<at::Tensor> scale;
    if (grad_scale) scale = *grad_scale;
    auto p = list(params, n), g = list(grads, n), em = list(m, n), ev = list(v, n), s = list(steps, n);
    at::_fused_adamw_(p, g, em, ev, {}, s, lr, beta1, beta2, weight_decay, eps, false, false, scale, {});
  });
}

int rl_foreach_mul(at::Tensor* const* self, size_t n, double factor) {
  return guarded([&] {
    at::NoGradGuard no_grad;
    at::_foreach_mul_(list(self, n), at::Scalar(factor));
  });
}

int rl_foreach_add_scalar(at::Tensor* const* self, size_t n, double value) {
  return guarded([&] {
    at::NoGradGuard no_grad;
    at::_foreach_add_(list(self, n), at::Scalar(value));
  });
}

// self += alpha * other
int rl_foreach_add(at::Tensor* const* self, at::Tensor* const* other, size_t n, double alpha) {
  return guarded([&] {
    at::NoGradGuard no_grad;
    at::_foreach_add_(list(self, n), list(other, n), at::Scalar(alpha));
  });
}

// self += weight * (other - self)
int rl_foreach_lerp(at::Tensor* const* self, at::Tensor* const* other, size_t n, double weight) {
  return guarded([&] {
    at::NoGradGuard no_grad;
    at::_foreach_lerp_(list(self, n), list(other, n), at::Scalar(weight));
  });
}

// The sum of squares of each tensor.
int rl_squares(at::Tensor* const* tensors, size_t n, double* out) {
  return guarded([&] {
    at::NoGradGuard no_grad;
    if (n > 0 && !tensors[0]->is_cpu()) {
      // Asked of a GPU one by one, each answer would be waited for.
      const auto norms = at::stack(at::_foreach_norm(list(tensors, n), 2, at::kDouble)).cpu();
      for (size_t i = 0; i < n; ++i) {
        const double norm = norms.const_data_ptr<double>()[i];
        out[i] = norm * norm;
      }
      return;
    }
    for (size_t i = 0; i < n; ++i) {
      const auto& t = *tensors[i];
      if (t.is_cpu() && t.scalar_type() == at::kFloat && t.is_contiguous()) {
        out[i] = squares(t.const_data_ptr<float>(), t.numel());
      } else {
        const double norm = at::norm(t).item<double>();
        out[i] = norm * norm;
      }
    }
  });
}

// Autocast of CPU ops to bfloat16 on this thread; gives back whether it was on.
int rl_autocast_cpu(int enabled, int* before) {
  return guarded([&] {
    *before = at::autocast::is_autocast_enabled(at::kCPU);
    at::autocast::set_autocast_enabled(at::kCPU, enabled != 0);
    if (enabled) {
      at::autocast::set_autocast_dtype(at::kCPU, at::kBFloat16);
      at::autocast::increment_nesting();
    } else if (at::autocast::decrement_nesting() == 0) {
      at::autocast::clear_cache();
    }
  });
}

int rl_configure(int deterministic, int flush_denormal) {
  return guarded([&] {
    at::globalContext().setDeterministicAlgorithms(deterministic != 0, false);
    // Filling every fresh tensor with NaN is for debugging; it costs 4 % of a step.
    at::globalContext().setDeterministicFillUninitializedMemory(false);
    at::globalContext().setFlushDenormal(flush_denormal != 0);
  });
}

// The state of a GPU's generator, or of the CPU's for -1; `size` bytes.
int rl_rng_get(int gpu, unsigned char* out, size_t room, size_t* size) {
  return guarded([&] {
    auto state = generator_of(gpu).get_state();
    *size = state.numel();
    if (room >= *size) std::memcpy(out, state.data_ptr(), *size);
  });
}

int rl_rng_set(int gpu, const unsigned char* bytes, size_t size) {
  return guarded([&] {
    auto state = at::empty({static_cast<int64_t>(size)}, at::kByte);
    std::memcpy(state.data_ptr(), bytes, size);
    generator_of(gpu).set_state(state);
  });
}

// From now on this thread has a CPU generator of its own, seeded.
int rl_rng_own(uint64_t seed) {
  return guarded([&] { own_generator = at::detail::createCPUGenerator(seed); });
}

const char* rl_cpu_capability() {
  static const std::string text = at::get_cpu_capability();
  return text.c_str();
}

// Counts the operations of products of matrices of this thread and of the backward passes it begins; gives a handle and
// what was counted before.
int rl_flops_begin(uint64_t* handle, uint64_t* before) {
  return guarded([&] {
    *before = flops;
    *handle = at::addThreadLocalCallback(
        at::RecordFunctionCallback(count_flops).needsInputs(true).scopes({at::RecordScope::FUNCTION}));
  });
}

int rl_flops_end(uint64_t handle, uint64_t* count) {
  return guarded([&] {
    at::removeCallback(handle);
    *count = flops;
  });
}

const char* rl_version() { return TORCH_VERSION; }

}  // extern "C"
