// Affine maps of many rows in f32 on processors for which oneDNN multiplies matrices faster than what libtorch takes:
// MKL has no 512-bit products for those that are not Intel's.

#include "shim.h"

#include <ATen/ATen.h>
#include <ATen/autocast_mode.h>
#include <ATen/core/dispatch/Dispatcher.h>
#include <torch/csrc/autograd/custom_function.h>
#include <optional>

namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

using Product = Tensor(const Tensor&, const Tensor&, const std::optional<Tensor>&, c10::string_view,
                       c10::List<std::optional<at::Scalar>>, std::optional<c10::string_view>);

// Sums of fewer terms both libraries add in order, so that either gives the same bits, and how many rows there are may
// choose the faster: oneDNN gains nothing for fewer rows or multiplications than these.
constexpr int64_t kInOrder = 256;
constexpr int64_t kRows = 256;
constexpr int64_t kProducts = int64_t{1} << 25;
// Longer sums they split differently. There it is oneDNN however many rows there are, but for so few that MKL would give
// other bits too: what a mesh comes to must not hang on those beside it.
constexpr int64_t kFew = 8;

// Whether x [rows, k] and w [n, k] are multiplied by oneDNN.
bool is_ours(int64_t rows, int64_t k, int64_t n) {
  return k < kInOrder ? rows >= kRows && rows * k * n >= kProducts : rows >= kFew;
}

bool is_processor() {
#if defined(__x86_64__) && defined(__GNUC__)
  return __builtin_cpu_is("amd") && __builtin_cpu_supports("avx512f");
#else
  return false;
#endif
}

// oneDNN's product, where it is the faster one and this libtorch has it.
const std::optional<c10::TypedOperatorHandle<Product>>& product() {
  static const auto found = []() -> std::optional<c10::TypedOperatorHandle<Product>> {
    if (!is_processor()) return std::nullopt;
    const auto op = c10::Dispatcher::singleton().findSchema({"mkldnn::_linear_pointwise", ""});
    if (!op) return std::nullopt;
    return op->typed<Product>();
  }();
  return found;
}

// x w for x [m, k] and w [k, n] whose rows are contiguous: oneDNN is slower where they are not.
Tensor times(const Tensor& x, const Tensor& w, const std::optional<Tensor>& bias) {
  return product()->call(x, w.contiguous().t(), bias, "none", c10::List<std::optional<at::Scalar>>(), "");
}

bool is_plain(const Tensor& t) { return t.device().is_cpu() && t.scalar_type() == at::kFloat && !t.is_mkldnn(); }

struct Affine : torch::autograd::Function<Affine> {
  static Tensor forward(AutogradContext* context, const Tensor& x, const Tensor& w,
                        const std::optional<Tensor>& bias) {
    context->save_for_backward({x, w});
    context->saved_data["bias"] = bias.has_value();
    return times(x, w.t(), bias);
  }

  static variable_list backward(AutogradContext* context, variable_list grads) {
    const auto saved = context->get_saved_variables();
    const Tensor grad = grads[0].contiguous(), &x = saved[0], &w = saved[1];
    Tensor dx, dw, db;
    if (context->needs_input_grad(0)) dx = times(grad, w, std::nullopt);
    // Its sum goes over rows, which oneDNN shares badly among threads.
    if (context->needs_input_grad(1)) dw = grad.t().mm(x);
    if (context->saved_data["bias"].toBool() && context->needs_input_grad(2)) db = grad.sum(0);
    return {dx, dw, db};
  }
};

}  // namespace

extern "C" {

// x [.., k] to x wᵀ + bias [.., n]; `bias` may be null.
int rl_linear(const Tensor* x, const Tensor* w, const Tensor* bias, Tensor** out) {
  return guarded([&] {
    const bool fits = x->dim() >= 1 && w->dim() == 2 && x->size(-1) == w->size(1) && is_plain(*x) && is_plain(*w) &&
                      (!bias || (is_plain(*bias) && bias->dim() == 1 && bias->size(0) == w->size(0)));
    const int64_t rows = fits && x->size(-1) > 0 ? x->numel() / x->size(-1) : 0;
    const bool fast = fits && is_ours(rows, w->size(1), w->size(0)) && !at::autocast::is_autocast_enabled(at::kCPU) &&
                      product().has_value();
    const auto added = bias ? std::optional<Tensor>(*bias) : std::nullopt;
    if (!fast) {
      *out = new Tensor(at::linear(*x, *w, added));
      return;
    }
    auto shape = x->sizes().vec();
    shape.back() = w->size(0);
    const Tensor flat = x->reshape({rows, x->size(-1)}).contiguous();
    *out = new Tensor(Affine::apply(flat, *w, added).view(shape));
  });
}

// Whether this processor has products of ours.
int rl_linear_is_ours() { return product().has_value() ? 1 : 0; }

}  // extern "C"
