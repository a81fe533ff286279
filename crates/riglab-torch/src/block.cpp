// The halves of a pre-norm transformer block as one node each, on the CPU: libtorch's bookkeeping of some forty small ops
// takes as long as what they compute. The ops are the same, and so are the numbers.

#include "linear.h"
#include "shim.h"

#include <ATen/ATen.h>
#include <ATen/core/LegacyTypeDispatch.h>
#include <torch/csrc/autograd/custom_function.h>
#include <array>
#include <cmath>
#include <optional>

namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;
using Bias = std::optional<Tensor>;
// Ops of a node are nobody else's: they need no graph, and no looking for one.
using Below = at::AutoDispatchBelowADInplaceOrView;

constexpr double kEps = 1e-5;

Tensor rows_of(const Tensor& x) { return x.reshape({-1, x.size(-1)}); }

Bias given(const Tensor& t) { return t.defined() ? Bias(t) : std::nullopt; }

void once() { TORCH_CHECK(!at::GradMode::is_enabled(), "halves of a block have no second derivative"); }

struct Normed {
  Tensor rows, mean, rstd;
};

Normed norm(const Tensor& x, const Tensor& gain, const Tensor& bias) {
  auto [y, mean, rstd] = at::native_layer_norm(x, {x.size(-1)}, gain, bias, kEps);
  return {rows_of(y), mean, rstd};
}

// Gradients of x, gain and bias.
std::array<Tensor, 3> norm_back(const Tensor& grad, const Tensor& x, const Tensor& mean, const Tensor& rstd,
                                const Tensor& gain, const Tensor& bias) {
  auto [dx, dgain, dbias] = at::native_layer_norm_backward(grad.view(x.sizes()), x, {x.size(-1)}, mean, rstd, gain,
                                                           bias, {true, true, true});
  return {dx, dgain, dbias};
}

// Gradients of a weight and a bias, of rows x and of those of what it makes of them.
std::array<Tensor, 2> weight_back(const Tensor& grad, const Tensor& x, bool bias) {
  return {grad.t().mm(x), bias ? grad.sum(0) : Tensor()};
}

// Of rows [b t, n d] part k of n, by heads: [b, h, t, e]. `fused`: each head has its parts side by side.
Tensor part(const Tensor& rows, int64_t batch, int64_t heads, int64_t n, int64_t k, bool fused) {
  const int64_t t = rows.size(0) / batch, e = rows.size(1) / n / heads;
  const auto apart = fused ? rows.view({batch, t, heads, n, e}).select(3, k) : rows.view({batch, t, n, heads, e}).select(2, k);
  return apart.transpose(1, 2);
}

// [b, h, t, e] as rows [b t, h e].
Tensor joined(const Tensor& x) { return x.transpose(1, 2).reshape({-1, x.size(1) * x.size(3)}); }

// softmax(q kᵀ / √e) v of heads [b, h, t, e], and what its backward pass reads: in f32 q, k, v and the scores' sums, of
// libtorch's fused kernel; in bfloat16, in which that kernel's backward pass is many times slower than plain products,
// q / √e, k and v as [b h, t, e] and the scores after the softmax.
struct Attended {
  Tensor mixed, q, k, v, kept;
};

bool is_plain(const Tensor& t) { return t.scalar_type() == at::kBFloat16; }

// [b, h, t, e] as [b h, t, e].
Tensor heads_of(const Tensor& x) { return x.reshape({-1, x.size(2), x.size(3)}); }

double scale_of(const Tensor& q) { return 1.0 / std::sqrt(static_cast<double>(q.size(-1))); }

Attended attend(const Tensor& q, const Tensor& k, const Tensor& v) {
  if (!is_plain(q)) {
    auto [mixed, sums] = at::_scaled_dot_product_flash_attention_for_cpu(q, k, v);
    return {mixed, q, k, v, sums};
  }
  auto asked = at::empty(q.sizes(), q.options());
  at::mul_out(asked, q, at::scalar_tensor(scale_of(q), at::kDouble));
  asked = heads_of(asked);
  const auto keys = heads_of(k), values = heads_of(v);
  const auto shares = at::_softmax(at::bmm(asked, keys.transpose(1, 2)), -1, false);
  return {at::bmm(shares, values).view(q.sizes()), asked, keys, values, shares};
}

// Gradients of q, k and v as they were given, of that of `mixed`.
std::array<Tensor, 3> attend_back(const Tensor& grad, const Attended& a) {
  if (!is_plain(grad)) {
    const auto [dq, dk, dv] = at::_scaled_dot_product_flash_attention_for_cpu_backward(grad, a.q, a.k, a.v, a.mixed,
                                                                                       a.kept, 0.0, false);
    return {dq, dk, dv};
  }
  const auto rows = heads_of(grad);
  const auto dshares = at::bmm(rows, a.v.transpose(1, 2));
  const auto dscores = at::_softmax_backward_data(dshares, a.kept, -1, at::kBFloat16);
  const auto by_heads = [&](const Tensor& x) { return x.view({grad.size(0), grad.size(1), x.size(1), x.size(2)}); };
  return {by_heads(at::bmm(dscores, a.k).mul_(scale_of(grad))), by_heads(at::bmm(dscores.transpose(1, 2), a.q)),
          by_heads(at::bmm(a.kept.transpose(1, 2), rows))};
}

// x + W₂ gelu(W₁ LN(x) + b₁) + b₂
struct FeedForward : Function<FeedForward> {
  static Tensor forward(AutogradContext* context, const Tensor& x, const Tensor& gain, const Tensor& bias,
                        const Tensor& up, const Tensor& up_bias, const Tensor& down, const Tensor& down_bias) {
    Below below;
    const auto own = norm(x, gain, bias);
    const auto inner = affine_rows(own.rows, up, up_bias);
    const auto bent = at::gelu(inner, "none");
    auto y = affine_rows(bent, down, down_bias).view(x.sizes());
    context->save_for_backward({x, gain, bias, own.rows, own.mean, own.rstd, inner, bent, up, down});
    return y.add_(x);
  }

  static variable_list backward(AutogradContext* context, variable_list grads) {
    once();
    Below below;
    const auto s = context->get_saved_variables();
    const Tensor &x = s[0], &gain = s[1], &bias = s[2], &own = s[3], &inner = s[6], &bent = s[7], &up = s[8],
                 &down = s[9];
    const auto grad = grads[0].contiguous();
    const auto rows = rows_of(grad);
    const auto [ddown, ddown_bias] = weight_back(rows, bent, true);
    const auto dinner = at::gelu_backward(affine_rows_back(rows, down), inner, "none");
    const auto [dup, dup_bias] = weight_back(dinner, own, true);
    auto [dx, dgain, dbias] = norm_back(affine_rows_back(dinner, up), x, s[4], s[5], gain, bias);
    return {dx.add_(grad), dgain, dbias, dup, dup_bias, ddown, ddown_bias};
  }
};

// x + W_o Attn(W LN(x)) + b_o over itself; W is made of query, key and value, as one matrix or three.
struct OwnAttention : Function<OwnAttention> {
  static Tensor forward(AutogradContext* context, const Tensor& x, const Tensor& gain, const Tensor& bias,
                        const Tensor& q, const Bias& k, const Bias& v, const Bias& all_bias, const Tensor& out,
                        const Tensor& out_bias, int64_t heads, bool fused) {
    Below below;
    const auto all = k ? at::cat({q, *k, *v}, 0) : q;
    const auto own = norm(x, gain, bias);
    const auto rows = affine_rows(own.rows, all, all_bias);
    const int64_t b = x.size(0);
    const auto a = attend(part(rows, b, heads, 3, 0, fused), part(rows, b, heads, 3, 1, fused),
                          part(rows, b, heads, 3, 2, fused));
    auto y = affine_rows(joined(a.mixed), out, out_bias).view(x.sizes());
    context->save_for_backward(
        {x, gain, bias, own.rows, own.mean, own.rstd, a.mixed, a.q, a.k, a.v, a.kept, all, out});
    context->saved_data["apart"] = k.has_value();
    context->saved_data["biased"] = all_bias.has_value();
    context->saved_data["heads"] = heads;
    context->saved_data["fused"] = fused;
    return y.add_(x);
  }

  static variable_list backward(AutogradContext* context, variable_list grads) {
    once();
    Below below;
    const auto s = context->get_saved_variables();
    const Tensor &x = s[0], &gain = s[1], &bias = s[2], &own = s[3], &all = s[11], &out = s[12];
    const Attended a{s[6], s[7], s[8], s[9], s[10]};
    const int64_t heads = context->saved_data["heads"].toInt(), b = x.size(0);
    const bool fused = context->saved_data["fused"].toBool();
    const auto grad = grads[0].contiguous();
    const auto [dout, dout_bias] = weight_back(rows_of(grad), joined(a.mixed), true);
    const auto parts = attend_back(part(affine_rows_back(rows_of(grad), out), b, heads, 1, 0, false), a);
    const auto drows = at::empty({own.size(0), all.size(0)}, x.options());
    for (int64_t k = 0; k < 3; ++k) part(drows, b, heads, 3, k, fused).copy_(parts[k]);
    const auto [dall, dall_bias] = weight_back(drows, own, context->saved_data["biased"].toBool());
    auto [dx, dgain, dbias] = norm_back(affine_rows_back(drows, all), x, s[4], s[5], gain, bias);
    dx.add_(grad);
    const int64_t d = out.size(1);
    if (!context->saved_data["apart"].toBool()) {
      return {dx, dgain, dbias, dall, {}, {}, dall_bias, dout, dout_bias, {}, {}};
    }
    return {dx,        dgain,     dbias, dall.narrow(0, 0, d), dall.narrow(0, d, d), dall.narrow(0, 2 * d, d),
            dall_bias, dout,      dout_bias, {}, {}};
  }
};

// Keys and values of LN(y) [b, s, c], side by side as they come out of the product: [b, s, 2 d].
struct Keys : Function<Keys> {
  static Tensor forward(AutogradContext* context, const Tensor& y, const Tensor& gain, const Tensor& bias,
                        const Tensor& k, const Bias& v, const Bias& both_bias) {
    Below below;
    const auto both = v ? at::cat({k, *v}, 0) : k;
    const auto own = norm(y, gain, bias);
    context->save_for_backward({y, gain, bias, own.rows, own.mean, own.rstd, both});
    context->saved_data["apart"] = v.has_value();
    context->saved_data["biased"] = both_bias.has_value();
    return affine_rows(own.rows, both, both_bias).view({y.size(0), y.size(1), both.size(0)});
  }

  static variable_list backward(AutogradContext* context, variable_list grads) {
    once();
    Below below;
    const auto s = context->get_saved_variables();
    const Tensor &y = s[0], &gain = s[1], &bias = s[2], &own = s[3], &both = s[6];
    const auto grad = rows_of(grads[0].contiguous());
    const auto [dboth, dboth_bias] = weight_back(grad, own, context->saved_data["biased"].toBool());
    auto [dy, dgain, dbias] = norm_back(affine_rows_back(grad, both), y, s[4], s[5], gain, bias);
    const int64_t d = both.size(0) / 2;
    if (!context->saved_data["apart"].toBool()) return {dy, dgain, dbias, dboth, {}, dboth_bias};
    return {dy, dgain, dbias, dboth.narrow(0, 0, d), dboth.narrow(0, d, d), dboth_bias};
  }
};

// x + W_o Attn(W_q LN(x), keys) + b_o, with keys [r, s, 2 d] as `Keys` makes them: x [b, t, d] is read as r rows.
struct OtherAttention : Function<OtherAttention> {
  static Tensor forward(AutogradContext* context, const Tensor& x, const Tensor& gain, const Tensor& bias,
                        const Tensor& q, const Bias& q_bias, const Tensor& keys, const Tensor& out,
                        const Tensor& out_bias, int64_t heads, bool fused) {
    Below below;
    const auto own = norm(x, gain, bias);
    const auto asked = affine_rows(own.rows, q, q_bias);
    const int64_t r = keys.size(0);
    const auto both = rows_of(keys);
    const auto a = attend(part(asked, r, heads, 1, 0, false), part(both, r, heads, 2, 0, fused),
                          part(both, r, heads, 2, 1, fused));
    auto y = affine_rows(joined(a.mixed), out, out_bias).view(x.sizes());
    context->save_for_backward(
        {x, gain, bias, own.rows, own.mean, own.rstd, a.mixed, a.q, a.k, a.v, a.kept, q, out});
    context->saved_data["keys"] = keys.sizes();
    context->saved_data["biased"] = q_bias.has_value();
    context->saved_data["heads"] = heads;
    context->saved_data["fused"] = fused;
    return y.add_(x);
  }

  static variable_list backward(AutogradContext* context, variable_list grads) {
    once();
    Below below;
    const auto s = context->get_saved_variables();
    const Tensor &x = s[0], &gain = s[1], &bias = s[2], &own = s[3], &q = s[11], &out = s[12];
    const Attended a{s[6], s[7], s[8], s[9], s[10]};
    const auto keys = context->saved_data["keys"].toIntVector();
    const int64_t heads = context->saved_data["heads"].toInt(), r = keys[0];
    const bool fused = context->saved_data["fused"].toBool();
    const auto grad = grads[0].contiguous();
    const auto [dout, dout_bias] = weight_back(rows_of(grad), joined(a.mixed), true);
    const auto [dq, dk, dv] = attend_back(part(affine_rows_back(rows_of(grad), out), r, heads, 1, 0, false), a);
    const auto dkeys = at::empty({keys[0] * keys[1], keys[2]}, x.options());
    part(dkeys, r, heads, 2, 0, fused).copy_(dk);
    part(dkeys, r, heads, 2, 1, fused).copy_(dv);
    const auto dasked = joined(dq);
    const auto [dweight, dweight_bias] = weight_back(dasked, own, context->saved_data["biased"].toBool());
    auto [dx, dgain, dbias] = norm_back(affine_rows_back(dasked, q), x, s[4], s[5], gain, bias);
    return {dx.add_(grad), dgain, dbias,     dweight, dweight_bias, dkeys.view(keys),
            dout,          dout_bias, {}, {}};
  }
};

Bias of(const Tensor* t) { return t ? Bias(*t) : std::nullopt; }

}  // namespace

extern "C" {

int rl_block_feed_forward(const Tensor* x, const Tensor* gain, const Tensor* bias, const Tensor* up,
                          const Tensor* up_bias, const Tensor* down, const Tensor* down_bias, Tensor** out) {
  return guarded(
      [&] { *out = new Tensor(FeedForward::apply(*x, *gain, *bias, *up, *up_bias, *down, *down_bias)); });
}

// `k` and `v` are null where `q` holds all three; so is `all_bias` where there is none.
int rl_block_own(const Tensor* x, const Tensor* gain, const Tensor* bias, const Tensor* q, const Tensor* k,
                 const Tensor* v, const Tensor* all_bias, const Tensor* o, const Tensor* o_bias, int64_t heads,
                 int fused, Tensor** out) {
  return guarded([&] {
    *out = new Tensor(
        OwnAttention::apply(*x, *gain, *bias, *q, of(k), of(v), of(all_bias), *o, *o_bias, heads, fused != 0));
  });
}

// `v` is null where `k` holds both; so is `both_bias` where there is none.
int rl_block_keys(const Tensor* y, const Tensor* gain, const Tensor* bias, const Tensor* k, const Tensor* v,
                  const Tensor* both_bias, Tensor** out) {
  return guarded([&] { *out = new Tensor(Keys::apply(*y, *gain, *bias, *k, of(v), of(both_bias))); });
}

// `q_bias` is null where there is none.
int rl_block_other(const Tensor* x, const Tensor* gain, const Tensor* bias, const Tensor* q, const Tensor* q_bias,
                   const Tensor* keys, const Tensor* o, const Tensor* o_bias, int64_t heads, int fused, Tensor** out) {
  return guarded([&] {
    *out = new Tensor(OtherAttention::apply(*x, *gain, *bias, *q, of(q_bias), *keys, *o, *o_bias, heads, fused != 0));
  });
}

}  // extern "C"
