// What a Qwen layer does row by row between its products, forwards and backwards, each as one pass over memory: the norm
// of rows; the norm of heads with their turn by place; the gate. As ops of libtorch they are some thirty a layer, each of
// which goes through memory by itself. Sums are in the order of sixteen lanes, on every machine; between the passes the
// inputs alone are held.

#include "shim.h"

#include <ATen/ATen.h>
#include <ATen/Parallel.h>
#include <ATen/core/LegacyTypeDispatch.h>
#include <torch/csrc/autograd/custom_function.h>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <type_traits>
#include <vector>

// The same function for several kinds of processors; which one runs is found when the program starts.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define RL_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define RL_CLONES
#endif
#define RL_INLINE inline __attribute__((always_inline))

namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;
// Ops of a node are nobody else's: they need no graph, and no looking for one.
using Below = at::AutoDispatchBelowADInplaceOrView;

// Rows that one thread takes at a time, and by which sums over rows are parted.
constexpr int64_t kRows = 64;
constexpr int kLanes = 16;

// What numbers are computed in. bfloat16 is the upper half of an f32.
template <typename T> struct Wide { using type = T; };
template <> struct Wide<uint16_t> { using type = float; };
template <typename T> using Op = typename Wide<T>::type;

RL_INLINE float widened(uint16_t x) {
  const uint32_t bits = static_cast<uint32_t>(x) << 16;
  float out;
  std::memcpy(&out, &bits, 4);
  return out;
}
RL_INLINE float widened(float x) { return x; }
RL_INLINE double widened(double x) { return x; }

RL_INLINE void store(float* to, float x) { *to = x; }
RL_INLINE void store(double* to, double x) { *to = x; }
// To the nearest, of two as near to the even one.
RL_INLINE void store(uint16_t* to, float x) {
  uint32_t bits;
  std::memcpy(&bits, &x, 4);
  const uint32_t rounded = (bits + 0x7fff + ((bits >> 16) & 1)) >> 16;
  *to = static_cast<uint16_t>((bits & 0x7fffffff) > 0x7f800000 ? 0x7fc0 : rounded);
}

template <typename O, typename F> RL_INLINE O sum(int64_t n, F of) {
  O lanes[kLanes] = {};
  int64_t k = 0;
  for (; k + kLanes <= n; k += kLanes) {
    for (int j = 0; j < kLanes; ++j) lanes[j] += of(k + j);
  }
  for (int j = 0; k < n; ++k, ++j) lanes[j] += of(k);
  for (int half = kLanes / 2; half > 0; half /= 2) {
    for (int j = 0; j < half; ++j) lanes[j] += lanes[j + half];
  }
  return lanes[0];
}

RL_INLINE double exponential(double x) { return std::exp(x); }
// To an ulp or two: the rest after whole powers of two by a polynomial. No call, so that loops over it are vectors.
RL_INLINE float exponential(float x) {
  // NaN becomes a number here, for the whole powers; it comes back by what this is multiplied with.
  x = std::min(88.0f, std::max(-87.0f, x));
  const float shifted = x * 1.44269504f + 12582912.0f;  // 1.5 · 2²³: what is added last is a whole number
  const float whole = shifted - 12582912.0f;
  const float rest = (x - whole * 0.693359375f) + whole * 2.12194440e-4f;
  float p = 1.9875691500e-4f;
  p = p * rest + 1.3981999507e-3f;
  p = p * rest + 8.3334519073e-3f;
  p = p * rest + 4.1665795894e-2f;
  p = p * rest + 1.6666665459e-1f;
  p = p * rest + 5.0000001201e-1f;
  p = p * rest * rest + rest + 1.0f;
  const uint32_t power = static_cast<uint32_t>(static_cast<int32_t>(whole) + 127) << 23;
  float scale;
  std::memcpy(&scale, &power, 4);
  return p * scale;
}

// 1 / √(mean x² + eps) of a row that was widened into `a`.
template <typename T> RL_INLINE Op<T> scale_of(const T* x, Op<T>* a, int64_t d, double eps) {
  for (int64_t k = 0; k < d; ++k) a[k] = widened(x[k]);
  const auto square = sum<Op<T>>(d, [&](int64_t k) { return a[k] * a[k]; });
  return 1 / std::sqrt(square / static_cast<Op<T>>(d) + static_cast<Op<T>>(eps));
}

// Of the gradient `b` of a normed row's numbers before the gain, that of the row `a`, whose scale is r.
template <typename T> RL_INLINE void norm_back(const Op<T>* a, const Op<T>* b, Op<T> r, T* dx, int64_t d) {
  const auto along = sum<Op<T>>(d, [&](int64_t k) { return a[k] * b[k]; });
  const Op<T> pull = r * r * r * along / static_cast<Op<T>>(d);
  for (int64_t k = 0; k < d; ++k) store(&dx[k], r * b[k] - pull * a[k]);
}

// Rows of d numbers, their gain, and where the normed ones go; backwards the gradient of these, and where theirs go.
template <typename T> struct Norm {
  const T *x, *gain, *dy;
  T* out;
  Op<T>* dgain;
  int64_t d;
  double eps;
};

template <typename T> RL_INLINE void norm_rows(const Norm<T>& n, Op<T>* scratch, int64_t from, int64_t to) {
  Op<T>* a = scratch;
  for (int64_t row = from; row < to; ++row) {
    const auto r = scale_of(n.x + row * n.d, a, n.d, n.eps);
    T* out = n.out + row * n.d;
    for (int64_t k = 0; k < n.d; ++k) store(&out[k], a[k] * r * widened(n.gain[k]));
  }
}

template <typename T> RL_INLINE void norm_rows_back(const Norm<T>& n, Op<T>* scratch, int64_t from, int64_t to) {
  Op<T>*a = scratch, *b = scratch + n.d;
  for (int64_t row = from; row < to; ++row) {
    const auto r = scale_of(n.x + row * n.d, a, n.d, n.eps);
    const T* dy = n.dy + row * n.d;
    for (int64_t k = 0; k < n.d; ++k) {
      const auto g = widened(dy[k]);
      n.dgain[k] += g * a[k] * r;
      b[k] = g * widened(n.gain[k]);
    }
    norm_back(a, b, r, n.out + row * n.d, n.d);
  }
}

// Heads of a row: queries, keys, values, each e wide; the first two are normed and turned.
template <typename T> struct Heads {
  const T *x, *gain, *cos, *sin;
  T* parts[3];           // q, k, v; or their gradients
  T* dx;
  Op<T>* dgain;          // [h + kv, e]
  int64_t h, kv, e, places;
  double eps;

  RL_INLINE int64_t heads() const { return h + 2 * kv; }
  // Where head i of a row lies in its part.
  RL_INLINE T* at(int64_t row, int64_t i) const {
    if (i < h) return parts[0] + (row * h + i) * e;
    if (i < h + kv) return parts[1] + (row * kv + i - h) * e;
    return parts[2] + (row * kv + i - h - kv) * e;
  }
};

template <typename T> RL_INLINE void head_rows(const Heads<T>& n, Op<T>* scratch, int64_t from, int64_t to) {
  const int64_t half = n.e / 2;
  Op<T>* a = scratch;
  for (int64_t row = from; row < to; ++row) {
    const T *cos = n.cos + row % n.places * n.e, *sin = n.sin + row % n.places * n.e;
    for (int64_t i = 0; i < n.heads(); ++i) {
      const T* x = n.x + (row * n.heads() + i) * n.e;
      T* out = n.at(row, i);
      if (i >= n.h + n.kv) {
        std::memcpy(out, x, n.e * sizeof(T));
        continue;
      }
      const auto r = scale_of(x, a, n.e, n.eps);
      const T* gain = n.gain + i * n.e;
      for (int64_t k = 0; k < n.e; ++k) a[k] *= r * widened(gain[k]);
      for (int64_t k = 0; k < half; ++k) {
        const auto c = widened(cos[k]), s = widened(sin[k]);
        store(&out[k], a[k] * c - a[k + half] * s);
        store(&out[k + half], a[k + half] * c + a[k] * s);
      }
    }
  }
}

template <typename T> RL_INLINE void head_rows_back(const Heads<T>& n, Op<T>* scratch, int64_t from, int64_t to) {
  const int64_t half = n.e / 2;
  Op<T>*a = scratch, *b = scratch + n.e;
  for (int64_t row = from; row < to; ++row) {
    const T *cos = n.cos + row % n.places * n.e, *sin = n.sin + row % n.places * n.e;
    for (int64_t i = 0; i < n.heads(); ++i) {
      const T *x = n.x + (row * n.heads() + i) * n.e, *dy = n.at(row, i);
      T* dx = n.dx + (row * n.heads() + i) * n.e;
      if (i >= n.h + n.kv) {
        std::memcpy(dx, dy, n.e * sizeof(T));
        continue;
      }
      const auto r = scale_of(x, a, n.e, n.eps);
      const T* gain = n.gain + i * n.e;
      Op<T>* dgain = n.dgain + i * n.e;
      for (int64_t k = 0; k < half; ++k) {
        const auto c = widened(cos[k]), s = widened(sin[k]);
        const auto first = widened(dy[k]), second = widened(dy[k + half]);
        b[k] = first * c + second * s;
        b[k + half] = second * c - first * s;
      }
      for (int64_t k = 0; k < n.e; ++k) {
        dgain[k] += b[k] * a[k] * r;
        b[k] *= widened(gain[k]);
      }
      norm_back(a, b, r, dx, n.e);
    }
  }
}

// Rows of gates and of what they let through, each f wide. Loops are simple, one step each, for vectors to be made of them.
template <typename T> struct Gate {
  const T *x, *dy;
  T* out;
  int64_t f;
};

template <typename T> RL_INLINE void gate_rows(const Gate<T>& n, Op<T>* scratch, int64_t from, int64_t to) {
  Op<T>* g = scratch;
  for (int64_t row = from; row < to; ++row) {
    const T *gate = n.x + 2 * row * n.f, *up = gate + n.f;
    T* out = n.out + row * n.f;
    for (int64_t k = 0; k < n.f; ++k) g[k] = widened(gate[k]);
    for (int64_t k = 0; k < n.f; ++k) g[k] /= 1 + exponential(-g[k]);
    for (int64_t k = 0; k < n.f; ++k) store(&out[k], g[k] * widened(up[k]));
  }
}

template <typename T> RL_INLINE void gate_rows_back(const Gate<T>& n, Op<T>* scratch, int64_t from, int64_t to) {
  Op<T>*g = scratch, *open = g + n.f, *d = open + n.f;
  for (int64_t row = from; row < to; ++row) {
    const T *gate = n.x + 2 * row * n.f, *up = gate + n.f, *dy = n.dy + row * n.f;
    T *dgate = n.out + 2 * row * n.f, *dup = dgate + n.f;
    for (int64_t k = 0; k < n.f; ++k) g[k] = widened(gate[k]);
    for (int64_t k = 0; k < n.f; ++k) d[k] = widened(dy[k]);
    for (int64_t k = 0; k < n.f; ++k) open[k] = 1 / (1 + exponential(-g[k]));
    for (int64_t k = 0; k < n.f; ++k) store(&dup[k], d[k] * g[k] * open[k]);
    for (int64_t k = 0; k < n.f; ++k) d[k] *= open[k] * (1 + g[k] * (1 - open[k]));
    for (int64_t k = 0; k < n.f; ++k) store(&dgate[k], d[k] * widened(up[k]));
  }
}

// Clones are made of functions, not of templates.
#define RL_KERNEL(name, Job)                                                                                     \
  RL_CLONES void name##_of(const Job<uint16_t>& job, float* scratch, int64_t from, int64_t to) {                 \
    name(job, scratch, from, to);                                                                                \
  }                                                                                                              \
  RL_CLONES void name##_of(const Job<float>& job, float* scratch, int64_t from, int64_t to) {                    \
    name(job, scratch, from, to);                                                                                \
  }                                                                                                              \
  void name##_of(const Job<double>& job, double* scratch, int64_t from, int64_t to) { name(job, scratch, from, to); }

RL_KERNEL(norm_rows, Norm)
RL_KERNEL(norm_rows_back, Norm)
RL_KERNEL(head_rows, Heads)
RL_KERNEL(head_rows_back, Heads)
RL_KERNEL(gate_rows, Gate)
RL_KERNEL(gate_rows_back, Gate)

// `work` on every kRows rows, with room for so many numbers, and the number of the run.
template <typename O, typename F> void each(int64_t rows, int64_t room, F work) {
  at::parallel_for(0, (rows + kRows - 1) / kRows, 2, [&](int64_t begin, int64_t end) {
    std::vector<O> scratch(room);
    for (int64_t run = begin; run < end; ++run) {
      work(scratch.data(), run, run * kRows, std::min(rows, (run + 1) * kRows));
    }
  });
}

// Calls f with a pointer of the type that a tensor's numbers are read as.
template <typename F> void of_kind(const Tensor& x, F f) {
  switch (x.scalar_type()) {
    case at::kBFloat16: return f(static_cast<uint16_t*>(nullptr));
    case at::kFloat: return f(static_cast<float*>(nullptr));
    case at::kDouble: return f(static_cast<double*>(nullptr));
    default: TORCH_CHECK(false, "rows of ", x.scalar_type());
  }
}

template <typename T> T* data(const Tensor& x) { return static_cast<T*>(x.data_ptr()); }

Tensor like(const Tensor& x, at::IntArrayRef sizes) { return at::empty(sizes, x.options().requires_grad(false)); }

// Sums of gains, one row a run of rows, to be added up in their order.
Tensor sums(const Tensor& x, int64_t rows, at::IntArrayRef sizes) {
  std::vector<int64_t> all{(rows + kRows - 1) / kRows};
  all.insert(all.end(), sizes.begin(), sizes.end());
  return at::zeros(all, x.options().requires_grad(false).dtype(x.scalar_type() == at::kDouble ? at::kDouble : at::kFloat));
}

void once() { TORCH_CHECK(!at::GradMode::is_enabled(), "norms, turns and gates of rows have no second derivative"); }

void same(const Tensor& x, std::initializer_list<Tensor> others) {
  TORCH_CHECK(x.device().is_cpu(), "rows on ", x.device());
  for (const auto& other : others) {
    TORCH_CHECK(other.device().is_cpu() && other.scalar_type() == x.scalar_type(), "rows of ", x.scalar_type(),
                " with numbers of ", other.scalar_type());
  }
}

struct NormRows : Function<NormRows> {
  static Tensor forward(AutogradContext* context, const Tensor& given, const Tensor& gain, double eps) {
    Below below;
    const auto x = given.contiguous(), own = gain.contiguous();
    const int64_t d = x.size(-1), rows = d > 0 ? x.numel() / d : 0;
    auto out = like(x, x.sizes());
    of_kind(x, [&](auto* kind) {
      using T = std::remove_pointer_t<decltype(kind)>;
      const Norm<T> job{data<T>(x), data<T>(own), nullptr, data<T>(out), nullptr, d, eps};
      each<Op<T>>(rows, d, [&](Op<T>* a, int64_t, int64_t from, int64_t to) { norm_rows_of(job, a, from, to); });
    });
    context->save_for_backward({x, own});
    context->saved_data["eps"] = eps;
    return out;
  }

  static variable_list backward(AutogradContext* context, variable_list grads) {
    once();
    Below below;
    const auto saved = context->get_saved_variables();
    const Tensor &x = saved[0], &gain = saved[1];
    const auto dy = grads[0].contiguous();
    const int64_t d = x.size(-1), rows = d > 0 ? x.numel() / d : 0;
    const double eps = context->saved_data["eps"].toDouble();
    auto dx = like(x, x.sizes()), dgain = sums(x, rows, {d});
    of_kind(x, [&](auto* kind) {
      using T = std::remove_pointer_t<decltype(kind)>;
      each<Op<T>>(rows, 2 * d, [&](Op<T>* a, int64_t run, int64_t from, int64_t to) {
        norm_rows_back_of(Norm<T>{data<T>(x), data<T>(gain), data<T>(dy), data<T>(dx), data<Op<T>>(dgain) + run * d, d, eps},
                          a, from, to);
      });
    });
    return {dx, dgain.sum(0).to(gain.scalar_type()), Tensor()};
  }
};

struct TurnedHeads : Function<TurnedHeads> {
  static variable_list forward(AutogradContext* context, const Tensor& given, const Tensor& gains, const Tensor& cos,
                               const Tensor& sin, int64_t h, double eps) {
    Below below;
    const auto x = given.contiguous(), gain = gains.contiguous(), c = cos.contiguous(), s = sin.contiguous();
    const int64_t rows = x.size(0), e = x.size(2), kv = (x.size(1) - h) / 2;
    auto q = like(x, {rows, h, e}), k = like(x, {rows, kv, e}), v = like(x, {rows, kv, e});
    of_kind(x, [&](auto* kind) {
      using T = std::remove_pointer_t<decltype(kind)>;
      const Heads<T> job{data<T>(x), data<T>(gain), data<T>(c), data<T>(s), {data<T>(q), data<T>(k), data<T>(v)},
                         nullptr, nullptr, h, kv, e, c.size(0), eps};
      each<Op<T>>(rows, e, [&](Op<T>* a, int64_t, int64_t from, int64_t to) { head_rows_of(job, a, from, to); });
    });
    context->save_for_backward({x, gain, c, s});
    context->saved_data["h"] = h;
    context->saved_data["eps"] = eps;
    return {q, k, v};
  }

  static variable_list backward(AutogradContext* context, variable_list grads) {
    once();
    Below below;
    const auto saved = context->get_saved_variables();
    const Tensor &x = saved[0], &gain = saved[1], &c = saved[2], &s = saved[3];
    const int64_t rows = x.size(0), e = x.size(2), h = context->saved_data["h"].toInt(), kv = (x.size(1) - h) / 2;
    const double eps = context->saved_data["eps"].toDouble();
    const auto given = [&](size_t part, int64_t heads) {
      return grads[part].defined() ? grads[part].contiguous() : at::zeros({rows, heads, e}, x.options().requires_grad(false));
    };
    const auto dq = given(0, h), dk = given(1, kv), dv = given(2, kv);
    auto dx = like(x, x.sizes()), dgain = sums(x, rows, gain.sizes());
    of_kind(x, [&](auto* kind) {
      using T = std::remove_pointer_t<decltype(kind)>;
      each<Op<T>>(rows, 2 * e, [&](Op<T>* a, int64_t run, int64_t from, int64_t to) {
        head_rows_back_of(Heads<T>{data<T>(x), data<T>(gain), data<T>(c), data<T>(s),
                                   {data<T>(dq), data<T>(dk), data<T>(dv)}, data<T>(dx),
                                   data<Op<T>>(dgain) + run * gain.numel(), h, kv, e, c.size(0), eps},
                          a, from, to);
      });
    });
    return {dx, dgain.sum(0).to(gain.scalar_type()), Tensor(), Tensor(), Tensor(), Tensor()};
  }
};

struct Gated : Function<Gated> {
  static Tensor forward(AutogradContext* context, const Tensor& given) {
    Below below;
    const auto x = given.contiguous();
    auto sizes = x.sizes().vec();
    sizes.back() /= 2;
    auto out = like(x, sizes);
    const int64_t f = sizes.back(), rows = f > 0 ? out.numel() / f : 0;
    of_kind(x, [&](auto* kind) {
      using T = std::remove_pointer_t<decltype(kind)>;
      const Gate<T> job{data<T>(x), nullptr, data<T>(out), f};
      each<Op<T>>(rows, f, [&](Op<T>* a, int64_t, int64_t from, int64_t to) { gate_rows_of(job, a, from, to); });
    });
    context->save_for_backward({x});
    return out;
  }

  static variable_list backward(AutogradContext* context, variable_list grads) {
    once();
    Below below;
    const auto x = context->get_saved_variables()[0];
    const auto dy = grads[0].contiguous();
    auto dx = like(x, x.sizes());
    const int64_t f = dy.size(-1), rows = f > 0 ? dy.numel() / f : 0;
    of_kind(x, [&](auto* kind) {
      using T = std::remove_pointer_t<decltype(kind)>;
      const Gate<T> job{data<T>(x), data<T>(dy), data<T>(dx), f};
      each<Op<T>>(rows, 3 * f, [&](Op<T>* a, int64_t, int64_t from, int64_t to) { gate_rows_back_of(job, a, from, to); });
    });
    return {dx};
  }
};

}  // namespace

extern "C" {

// x [.., d] / √(mean x² + eps) · gain [d].
int rl_norm_rows(const at::Tensor* x, const at::Tensor* gain, double eps, at::Tensor** out) {
  return guarded([&] {
    same(*x, {*gain});
    TORCH_CHECK(x->dim() > 0 && gain->dim() == 1 && gain->size(0) == x->size(-1), "a norm of ", x->sizes(), " with gains ",
                gain->sizes());
    *out = new at::Tensor(NormRows::apply(*x, *gain, eps));
  });
}

// Of x [t, h + 2 kv, e] the first h + kv heads normed with gains [h + kv, e] and turned, row r as place r mod p of
// cos and sin [p, .., e], and the others as they are: three new tensors q [t, h, e], k and v [t, kv, e].
int rl_turned_heads(const at::Tensor* x, const at::Tensor* gains, const at::Tensor* cos, const at::Tensor* sin, int64_t h,
                    double eps, at::Tensor** out) {
  return guarded([&] {
    same(*x, {*gains, *cos, *sin});
    TORCH_CHECK(x->dim() == 3 && h > 0 && x->size(1) > h && (x->size(1) - h) % 2 == 0 && x->size(2) % 2 == 0,
                h, " heads of queries among ", x->sizes());
    const int64_t e = x->size(2), kv = (x->size(1) - h) / 2;
    TORCH_CHECK(gains->sizes() == at::IntArrayRef({h + kv, e}) && cos->sizes() == sin->sizes() && cos->size(-1) == e &&
                    cos->size(0) * e == cos->numel() && cos->size(0) > 0 && x->size(0) % cos->size(0) == 0,
                "heads ", x->sizes(), " with gains ", gains->sizes(), " and turns ", cos->sizes());
    auto parts = TurnedHeads::apply(*x, *gains, *cos, *sin, h, eps);
    for (int k = 0; k < 3; ++k) out[k] = new at::Tensor(parts[k]);
  });
}

// silu(a) · b of x = [a, b], [.., 2 f], to [.., f].
int rl_gated(const at::Tensor* x, at::Tensor** out) {
  return guarded([&] {
    same(*x, {});
    TORCH_CHECK(x->dim() > 0 && x->size(-1) % 2 == 0, "gates of ", x->sizes());
    *out = new at::Tensor(Gated::apply(*x));
  });
}

}  // extern "C"
