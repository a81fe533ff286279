// Affine maps of many rows in f32 on processors for which oneDNN multiplies matrices faster than what libtorch takes:
// MKL has no 512-bit products for those that are not Intel's.

#include "linear.h"
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

// oneDNN gains nothing for fewer rows or multiplications than these.
constexpr int64_t kRows = 256;
constexpr int64_t kProducts = int64_t{1} << 25;
// Sums of at most so many terms both libraries add in order, which gives the same bits: what a row comes to does not
// hang on how many there are. Longer ones, which MKL splits, are left to it on the way forward.
constexpr int64_t kInOrder = 192;

bool is_amd_with_avx512() {
#if defined(__x86_64__) && defined(__GNUC__)
  return __builtin_cpu_is("amd") && __builtin_cpu_supports("avx512f");
#else
  return false;
#endif
}

// oneDNN's product, where it is the faster one and this libtorch has it.
const std::optional<c10::TypedOperatorHandle<Product>>& product() {
  static const auto found = []() -> std::optional<c10::TypedOperatorHandle<Product>> {
    if (!is_amd_with_avx512()) return std::nullopt;
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

// Of any axes before the last; what it gives is no view, so that it may be added to in place.
struct Affine : torch::autograd::Function<Affine> {
  static Tensor forward(AutogradContext* context, const Tensor& x, const Tensor& w,
                        const std::optional<Tensor>& bias) {
    context->save_for_backward({w.requires_grad() ? x : Tensor(), w});
    context->saved_data["bias"] = bias.has_value();
    context->saved_data["shape"] = x.sizes();
    if (w.size(1) > kInOrder) return at::linear(x, w, bias);
    auto shape = x.sizes().vec();
    shape.back() = w.size(0);
    return at::_unsafe_view(times(x.reshape({-1, w.size(1)}).contiguous(), w.t(), bias), shape);
  }

  static variable_list backward(AutogradContext* context, variable_list grads) {
    TORCH_CHECK(!at::GradMode::is_enabled(), "affine maps of many rows have no second derivative");
    const auto saved = context->get_saved_variables();
    const Tensor &x = saved[0], &w = saved[1];
    const Tensor grad = grads[0].reshape({-1, w.size(0)}).contiguous();
    Tensor dx, dw, db;
    if (context->needs_input_grad(0)) {
      dx = at::_unsafe_view(times(grad, w, std::nullopt), context->saved_data["shape"].toIntVector());
    }
    // Its sum goes over rows, which oneDNN shares badly among threads.
    if (context->needs_input_grad(1)) dw = grad.t().mm(x.reshape({-1, w.size(1)}));
    if (context->saved_data["bias"].toBool() && context->needs_input_grad(2)) db = grad.sum(0);
    return {dx, dw, db};
  }
};

// Whether maps of so many rows are ours. In bfloat16 libtorch takes oneDNN itself, by a way that is faster still.
bool is_ours(int64_t rows, const Tensor& w) {
  return w.scalar_type() == at::kFloat && rows >= kRows && rows * w.numel() >= kProducts && product().has_value();
}

}  // namespace

Tensor affine_rows(const Tensor& x, const Tensor& w, const std::optional<Tensor>& bias) {
  if (is_ours(x.size(0), w) && w.size(1) <= kInOrder) return times(x.contiguous(), w.t(), bias);
  return bias ? at::addmm(*bias, x, w.t()) : x.mm(w.t());
}

Tensor affine_rows_back(const Tensor& grad, const Tensor& w) {
  return is_ours(grad.size(0), w) ? times(grad.contiguous(), w, std::nullopt) : grad.mm(w);
}

extern "C" {

// x [.., k] to x wᵀ + bias [.., n]; `bias` may be null.
int rl_linear(const Tensor* x, const Tensor* w, const Tensor* bias, Tensor** out) {
  return guarded([&] {
    const bool fits = x->dim() >= 1 && w->dim() == 2 && x->size(-1) == w->size(1) && is_plain(*x) && is_plain(*w) &&
                      (!bias || (is_plain(*bias) && bias->dim() == 1 && bias->size(0) == w->size(0) &&
                                 bias->is_contiguous()));
    const int64_t rows = fits && x->size(-1) > 0 ? x->numel() / x->size(-1) : 0;
    const bool fast = fits && is_ours(rows, *w) && !at::autocast::is_autocast_enabled(at::kCPU);
    const auto added = bias ? std::optional<Tensor>(*bias) : std::nullopt;
    *out = new Tensor(fast ? Affine::apply(*x, *w, added) : at::linear(*x, *w, added));
  });
}

// Whether this processor has products of ours.
int rl_linear_is_ours() { return product().has_value() ? 1 : 0; }

}  // extern "C"
