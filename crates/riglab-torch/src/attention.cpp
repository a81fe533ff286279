// Attention of packed sequences: each sequence, or each head of few sequences, is a task of its own, and so is its
// backward pass, so that threads share whole tasks, not the products of one.

#include "shim.h"

#include <ATen/ATen.h>
#include <ATen/OpMathType.h>
#include <ATen/Parallel.h>
#include <ATen/ThreadLocalState.h>
#include <torch/csrc/autograd/custom_function.h>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <exception>
#include <limits>
#include <mutex>
#include <numeric>
#include <stdexcept>
#include <vector>

namespace {

using at::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

// Queries that ask at once: of those, the last sees all keys that any of them may see.
constexpr int64_t kRun = 256;
// Fewer sequences than these leave threads without work unless each is shared.
constexpr size_t kFew = 8;

// Rows of one sequence, and those of what it goes on from (none: `seen` is 0).
struct Span {
  int64_t from, rows, before, seen;
  int64_t keys() const { return seen + rows; }
};

// Numbers of a call that the backward pass needs again: heads of queries and of keys, width, then four a span.
struct Shape {
  int64_t heads, shared, width;
  std::vector<Span> spans;
  double scale() const { return 1.0 / std::sqrt(static_cast<double>(width)); }
  // Heads of queries that share one of keys.
  int64_t group() const { return heads / shared; }
};

// What one thread does at a time: `heads` heads of keys from `head` on, of one span.
struct Task {
  size_t span;
  int64_t head, heads;
};

// Few sequences are shared head by head. How, does not hang on the number of threads.
std::vector<Task> tasks_of(const Shape& shape) {
  const int64_t heads = shape.spans.size() < kFew ? 1 : shape.shared;
  std::vector<Task> tasks;
  for (size_t span = 0; span < shape.spans.size(); ++span) {
    for (int64_t head = 0; head < shape.shared; head += heads) tasks.push_back({span, head, heads});
  }
  return tasks;
}

// A task's part of the own rows of x [T, g, e].
Tensor part(const Tensor& x, const Span& span, const Task& task) {
  return x.narrow(0, span.from, span.rows).narrow(1, task.head, task.heads);
}

// Rows of x [T, g, e] that a task's queries may see, as [its g, s, e].
Tensor seen(const Tensor& x, const Span& span, const Task& task) {
  auto own = part(x, span, task);
  if (span.seen > 0) {
    own = at::cat({x.narrow(0, span.before, span.seen).narrow(1, task.head, task.heads), own}, 0);
  }
  return own.transpose(0, 1).contiguous();
}

// A task's part of the own rows of x [T, h, e], as [its g, h / g, t, e].
Tensor own(const Tensor& x, const Span& span, const Task& task, const Shape& shape) {
  return x.narrow(0, span.from, span.rows)
      .view({span.rows, shape.shared, shape.group(), shape.width})
      .narrow(1, task.head, task.heads)
      .permute({1, 2, 0, 3});
}

// A run of queries of [g, r, t, e], as [g, r * b, e].
Tensor run_of(const Tensor& x, int64_t from, int64_t count) {
  return x.narrow(2, from, count).reshape({x.size(0), x.size(1) * count, x.size(3)});
}

// Does every task, whichever thread comes to it, the longest first. What the caller's thread has set (gradients off,
// what is counted) holds in all.
template <typename F>
void each(const std::vector<Task>& tasks, const std::vector<Span>& spans, F work) {
  std::vector<size_t> order(tasks.size());
  std::iota(order.begin(), order.end(), 0);
  const auto cost = [&](size_t k) { return spans[tasks[k].span].rows * spans[tasks[k].span].keys(); };
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return cost(a) > cost(b); });
  std::atomic<size_t> next{0};
  std::mutex lock;
  std::exception_ptr failed;
  const at::ThreadLocalState state;
  at::parallel_for(0, at::get_num_threads(), 1, [&](int64_t, int64_t) {
    const at::ThreadLocalStateGuard as_the_caller(state);
    for (size_t k = next++; k < order.size(); k = next++) {
      try {
        work(order[k]);
      } catch (...) {
        std::lock_guard<std::mutex> held(lock);
        failed = std::current_exception();
      }
    }
  });
  if (failed) std::rethrow_exception(failed);
}

struct PackedAttention : torch::autograd::Function<PackedAttention> {
  // `keep`: whether there may be a backward pass, which needs the scores after the softmax.
  static variable_list forward(AutogradContext* context, Tensor q, Tensor k, Tensor v, const Shape& shape, bool keep) {
    const auto hidden =
        at::full({kRun, kRun}, -std::numeric_limits<double>::infinity(), q.options()).triu(1);
    auto out = at::empty({q.size(0), shape.heads, shape.width}, q.options());
    const auto tasks = tasks_of(shape);
    // Of each task and run of queries, the shares that its keys get.
    std::vector<variable_list> shares(tasks.size());
    each(tasks, shape.spans, [&](size_t number) {
      const auto& task = tasks[number];
      const auto& span = shape.spans[task.span];
      const auto queries = own(q, span, task, shape).contiguous() * shape.scale();
      const auto keys = seen(k, span, task), values = seen(v, span, task);
      auto place = own(out, span, task, shape);
      for (int64_t from = 0; from < span.rows; from += kRun) {
        const int64_t count = std::min(kRun, span.rows - from), last = span.seen + from + count;
        auto scores = at::bmm(run_of(queries, from, count), keys.narrow(1, 0, last).transpose(1, 2))
                          .view({task.heads, shape.group(), count, last});
        scores.narrow(3, last - count, count).add_(hidden.narrow(0, 0, count).narrow(1, 0, count));
        auto share = scores.softmax(-1).view({task.heads, shape.group() * count, last});
        place.narrow(2, from, count)
            .copy_(at::bmm(share, values.narrow(1, 0, last)).view({task.heads, shape.group(), count, shape.width}));
        if (keep) shares[number].push_back(std::move(share));
      }
    });
    if (keep) {
      variable_list kept{q, k, v};
      for (auto& of_task : shares) kept.insert(kept.end(), of_task.begin(), of_task.end());
      context->save_for_backward(std::move(kept));
      std::vector<int64_t> numbers{shape.heads, shape.shared, shape.width};
      for (const auto& s : shape.spans) numbers.insert(numbers.end(), {s.from, s.rows, s.before, s.seen});
      context->saved_data["shape"] = std::move(numbers);
    }
    return {out};
  }

  static variable_list backward(AutogradContext* context, variable_list grads) {
    TORCH_CHECK(!at::GradMode::is_enabled(), "attention of packed sequences has no second derivative");
    const auto kept = context->get_saved_variables();
    const auto numbers = context->saved_data["shape"].toIntVector();
    Shape shape{numbers[0], numbers[1], numbers[2], {}};
    for (size_t k = 3; k < numbers.size(); k += 4) {
      shape.spans.push_back({numbers[k], numbers[k + 1], numbers[k + 2], numbers[k + 3]});
    }
    const auto &q = kept[0], &k = kept[1], &v = kept[2];
    const auto tasks = tasks_of(shape);
    // Where the shares of each task begin.
    std::vector<size_t> first;
    size_t place = 3;
    for (const auto& task : tasks) {
      first.push_back(place);
      place += (shape.spans[task.span].rows + kRun - 1) / kRun;
    }
    const bool behind =
        std::any_of(shape.spans.begin(), shape.spans.end(), [](const Span& span) { return span.seen > 0; });
    auto dq = at::empty_like(q, at::MemoryFormat::Contiguous);
    // Rows that several sequences go on from are sums of many terms.
    const auto exact = at::toOpMathType(k.scalar_type());
    const auto sums = behind ? k.options().dtype(exact) : k.options();
    auto dk = at::empty(k.sizes(), sums), dv = at::empty(v.sizes(), sums);
    std::vector<std::pair<Tensor, Tensor>> before(tasks.size());
    each(tasks, shape.spans, [&](size_t number) {
      const auto& task = tasks[number];
      const auto& span = shape.spans[task.span];
      const auto queries = own(q, span, task, shape).contiguous() * shape.scale();
      const auto keys = seen(k, span, task), values = seen(v, span, task);
      const auto asked = own(grads[0], span, task, shape).contiguous();
      auto back = own(dq, span, task, shape);
      Tensor to_keys, to_values;
      // The last run sees all keys, so its sums are the whole ones that the others are added to.
      const int64_t runs = (span.rows + kRun - 1) / kRun;
      for (int64_t run = runs - 1; run >= 0; --run) {
        const int64_t from = run * kRun, count = std::min(kRun, span.rows - from), last = span.seen + from + count;
        const auto& share = kept[first[number] + run];
        const auto own_grads = run_of(asked, from, count);
        const auto to_share = at::bmm(own_grads, values.narrow(1, 0, last).transpose(1, 2));
        const auto to_scores = at::_softmax_backward_data(to_share, share, -1, share.scalar_type());
        back.narrow(2, from, count)
            .copy_((at::bmm(to_scores, keys.narrow(1, 0, last)) * shape.scale())
                       .view({task.heads, shape.group(), count, shape.width}));
        auto of_keys = at::bmm(to_scores.transpose(1, 2), run_of(queries, from, count));
        auto of_values = at::bmm(share.transpose(1, 2), own_grads);
        if (runs == 1) {
          to_keys = std::move(of_keys);
          to_values = std::move(of_values);
        } else if (!to_keys.defined()) {
          to_keys = of_keys.to(exact);
          to_values = of_values.to(exact);
        } else {
          to_keys.narrow(1, 0, last).add_(of_keys);
          to_values.narrow(1, 0, last).add_(of_values);
        }
      }
      const auto put = [&](const Tensor& all, const Tensor& found) {
        part(all, span, task).copy_(found.narrow(1, span.seen, span.rows).transpose(0, 1));
      };
      put(dk, to_keys);
      put(dv, to_values);
      if (span.seen > 0) {
        const auto of_before = [&](const Tensor& found) { return found.narrow(1, 0, span.seen).transpose(0, 1); };
        before[number] = {of_before(to_keys), of_before(to_values)};
      }
    });
    // In the order of the sequences, so that sums do not hang on which thread came first.
    for (size_t number = 0; number < tasks.size(); ++number) {
      const auto& task = tasks[number];
      const auto& span = shape.spans[task.span];
      if (span.seen == 0) continue;
      const auto rows = [&](const Tensor& all) {
        return all.narrow(0, span.before, span.seen).narrow(1, task.head, task.heads);
      };
      rows(dk).add_(before[number].first);
      rows(dv).add_(before[number].second);
    }
    return {dq, dk.to(k.scalar_type()), dv.to(v.scalar_type()), Tensor(), Tensor()};
  }
};

}  // namespace

extern "C" {

// softmax(q kᵀ / √e) v of q [T, h, e] and k, v [T, g, e], `spans` of four numbers each: the sequence's first row and its
// rows, and those that it goes on from. A row sees what its sequence goes on from, and its sequence up to itself. `out`
// becomes a new tensor, [T, h, e].
int rl_packed_attention(at::Tensor* const* qkv, const int64_t* spans, size_t n, at::Tensor** out) {
  return guarded([&] {
    const auto &q = *qkv[0], &k = *qkv[1], &v = *qkv[2];
    TORCH_CHECK(q.dim() == 3 && k.dim() == 3 && k.sizes() == v.sizes() && q.size(0) == k.size(0) &&
                    q.size(2) == k.size(2) && k.size(1) > 0 && q.size(1) % k.size(1) == 0,
                "queries ", q.sizes(), " over keys ", k.sizes(), " and values ", v.sizes());
    Shape shape{q.size(1), k.size(1), q.size(2), {}};
    int64_t rows = 0;
    for (size_t i = 0; i < n; ++i) {
      const Span span{spans[4 * i], spans[4 * i + 1], spans[4 * i + 2], spans[4 * i + 3]};
      TORCH_CHECK(span.from == rows && span.rows > 0 && span.before >= 0 && span.seen >= 0 &&
                      span.before + span.seen <= span.from,
                  "sequence ", i, " does not follow the one before it");
      rows += span.rows;
      shape.spans.push_back(span);
    }
    TORCH_CHECK(rows == q.size(0), "sequences of ", rows, " rows in all, not ", q.size(0));
    const bool keep =
        at::GradMode::is_enabled() && (q.requires_grad() || k.requires_grad() || v.requires_grad());
    *out = new at::Tensor(PackedAttention::apply(q, k, v, shape, keep)[0]);
  });
}

// softmax(q kᵀ / √e) v of sequences of these lengths one after another, q [T, h, e] and k, v [T, g, e], by the kernel of
// GPUs that takes them as they lie. A row sees its sequence up to itself. `out` becomes a new tensor, [T, h, e].
int rl_flash_attention(at::Tensor* const* qkv, const int64_t* lengths, size_t n, at::Tensor** out) {
  return guarded([&] {
    std::vector<int32_t> ends{0};
    int64_t longest = 0;
    for (size_t i = 0; i < n; ++i) {
      ends.push_back(ends.back() + static_cast<int32_t>(lengths[i]));
      longest = std::max(longest, lengths[i]);
    }
    const auto places = at::tensor(ends, at::kInt).to(qkv[0]->device());
    auto all = at::_flash_attention_forward(*qkv[0], *qkv[1], *qkv[2], places, places, longest, longest, 0.0, true, false);
    *out = new at::Tensor(std::move(std::get<0>(all)));
  });
}

}  // extern "C"
