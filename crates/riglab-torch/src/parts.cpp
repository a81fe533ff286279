// Parts of a network whose graphs are of threads of their own: one node stands for all of them.

#include "shim.h"

#include <ATen/ATen.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/csrc/autograd/function.h>
#include <torch/csrc/autograd/functions/utils.h>
#include <torch/csrc/autograd/variable.h>
#include <mutex>
#include <stdexcept>
#include <vector>

namespace {

using torch::autograd::Edge;
using torch::autograd::Node;
using torch::autograd::variable_list;

// Reads the gradients of all outputs, null where there is none, and gives those of the inputs, null where there is none,
// which are then the caller's. Gives 0, or 1 with a message. It never throws.
using Back = int (*)(void* parts, at::Tensor* const* grads, size_t n, at::Tensor** out, size_t m, char* message,
                     size_t room);
using Forget = void (*)(void* parts);

constexpr size_t kMessage = 1024;

struct Parts : Node {
  Back back;
  Forget forget;
  void* parts;

  Parts(Back back, Forget forget, void* parts) : back(back), forget(forget), parts(parts) {}
  ~Parts() override { release_variables(); }

  std::string name() const override { return "Parts"; }

  void release_variables() override {
    std::lock_guard<std::mutex> lock(mutex_);
    if (parts) forget(parts);
    parts = nullptr;
  }

  variable_list apply(variable_list&& grads) override {
    std::lock_guard<std::mutex> lock(mutex_);
    if (!parts) throw std::runtime_error("a backward pass went through parts side by side twice");
    if (at::GradMode::is_enabled()) throw std::runtime_error("parts side by side have no second derivative");
    std::vector<at::Tensor*> given;
    for (auto& g : grads) given.push_back(g.defined() ? &g : nullptr);
    std::vector<at::Tensor*> slots(num_outputs(), nullptr);
    char message[kMessage] = {0};
    const int code = back(parts, given.data(), given.size(), slots.data(), slots.size(), message, kMessage);
    variable_list found(slots.size());
    for (size_t i = 0; i < slots.size(); ++i) {
      if (!slots[i]) continue;
      found[i] = std::move(*slots[i]);
      delete slots[i];
    }
    if (code != 0) throw std::runtime_error(message);
    return found;
  }
};

}  // namespace

extern "C" {

// Gradients of `leaves` for outputs and theirs; null where a leaf has none. The graph is gone then.
int rl_gradients(at::Tensor* const* outputs, at::Tensor* const* grads, size_t n, at::Tensor* const* leaves, size_t m,
                 at::Tensor** out) {
  return guarded([&] {
    variable_list roots, seeds, asked;
    for (size_t i = 0; i < n; ++i) {
      roots.push_back(*outputs[i]);
      seeds.push_back(*grads[i]);
    }
    for (size_t i = 0; i < m; ++i) asked.push_back(*leaves[i]);
    auto found = torch::autograd::grad(roots, asked, seeds, std::nullopt, false, true);
    for (size_t i = 0; i < m; ++i) out[i] = found[i].defined() ? new at::Tensor(std::move(found[i])) : nullptr;
  });
}

// Puts a node before `out`, cut off from their graphs, whose backward pass gives the gradients of `inputs` by `back`.
// `parts` is given to `forget` once nothing needs it any more, at once if something fails.
int rl_parts(at::Tensor* const* inputs, size_t m, at::Tensor* const* out, size_t n, Back back, Forget forget,
             void* parts) {
  std::shared_ptr<Parts> node;
  const int code = guarded([&] {
    // Takes the parts over: from here on the node forgets them.
    node = std::shared_ptr<Parts>(new Parts(back, forget, parts), torch::autograd::deleteNode);
    torch::autograd::edge_list edges;
    for (size_t i = 0; i < m; ++i) edges.push_back(torch::autograd::impl::gradient_edge(*inputs[i]));
    node->set_next_edges(std::move(edges));
    for (size_t i = 0; i < n; ++i) torch::autograd::set_history(*out[i], node);
  });
  if (!node) forget(parts);
  return code;
}

// A number drawn from this thread's generator.
int rl_rng_draw(uint64_t* out) {
  return guarded([&] {
    auto generator = cpu_generator();
    std::lock_guard<std::mutex> lock(generator.mutex());
    *out = at::check_generator<at::CPUGeneratorImpl>(generator)->random64();
  });
}

}  // extern "C"
