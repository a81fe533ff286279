// Blocks that are computed again in the backward pass: between the passes they hold what they read, not what they
// computed on the way.

#include "shim.h"

#include <ATen/ATen.h>
#include <ATen/Context.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/csrc/autograd/function.h>
#include <torch/csrc/autograd/functions/accumulate_grad.h>
#include <torch/csrc/autograd/functions/utils.h>
#include <torch/csrc/autograd/saved_variable.h>
#include <torch/csrc/autograd/variable.h>
#include <mutex>
#include <stdexcept>
#include <unordered_set>
#include <vector>

namespace {

using torch::autograd::Edge;
using torch::autograd::Node;
using torch::autograd::SavedVariable;
using torch::autograd::variable_list;

// The block itself: reads `n` tensors and writes `made` new ones, which are then the caller's. Gives 0, or 1 with a
// message. It never throws.
using Again = int (*)(void* block, at::Tensor* const* read, size_t n, at::Tensor** out, size_t made, char* message,
                      size_t room);
using Forget = void (*)(void* block);

constexpr size_t kMessage = 1024;

// The node behind a block's outputs.
struct Recompute : Node {
  Again again;
  Forget forget;
  void* block;
  std::vector<SavedVariable> read;
  size_t made;

  Recompute(Again again, Forget forget, void* block) : again(again), forget(forget), block(block), made(0) {}
  ~Recompute() override { release_variables(); }

  std::string name() const override { return "Recompute"; }

  void release_variables() override {
    std::lock_guard<std::mutex> lock(mutex_);
    if (block) forget(block);
    block = nullptr;
    read.clear();
  }

  variable_list apply(variable_list&& grads) override {
    std::lock_guard<std::mutex> lock(mutex_);
    if (!block) throw std::runtime_error("a backward pass went through a block twice without keeping its graph");
    at::AutoGradMode with_grad(true);
    // What it reads, cut off from where that comes from; gradients are asked of what needs them in this pass.
    std::vector<at::Tensor> own, asked;
    std::vector<size_t> places;
    for (size_t i = 0; i < read.size(); ++i) {
      auto x = read[i].unpack().detach();
      if (task_should_compute_output(i)) {
        x.set_requires_grad(true);
        asked.push_back(x);
        places.push_back(i);
      }
      own.push_back(std::move(x));
    }
    variable_list roots, seeds;
    auto out = run(own);
    for (size_t i = 0; i < out.size(); ++i) {
      if (i < grads.size() && grads[i].defined() && out[i].requires_grad()) {
        roots.push_back(out[i]);
        seeds.push_back(std::move(grads[i]));
      }
    }
    out.clear();
    variable_list result(read.size());
    if (asked.empty() || roots.empty()) return result;
    check_leaves(roots, asked);
    auto found = torch::autograd::grad(roots, asked, seeds, std::nullopt, false, true);
    for (size_t k = 0; k < places.size(); ++k) result[places[k]] = std::move(found[k]);
    return result;
  }

 private:
  std::vector<at::Tensor> run(std::vector<at::Tensor>& own) {
    std::vector<at::Tensor*> inputs;
    for (auto& x : own) inputs.push_back(&x);
    std::vector<at::Tensor*> slots(made, nullptr);
    char message[kMessage] = {0};
    const int code = again(block, inputs.data(), inputs.size(), slots.data(), made, message, kMessage);
    std::vector<at::Tensor> out;
    for (auto* slot : slots) {
      if (!slot) continue;
      out.push_back(std::move(*slot));
      delete slot;
    }
    if (code != 0 || out.size() != made) throw std::runtime_error(message);
    return out;
  }

  // Every leaf that the outputs hang on is one that was handed in: the gradient of any other would be lost in silence.
  static void check_leaves(const variable_list& roots, const std::vector<at::Tensor>& asked) {
    std::unordered_set<const at::TensorImpl*> known;
    for (const auto& x : asked) known.insert(x.unsafeGetTensorImpl());
    std::unordered_set<Node*> seen;
    std::vector<Node*> open;
    auto visit = [&](Node* node) {
      if (node && seen.insert(node).second) open.push_back(node);
    };
    for (const auto& root : roots) visit(root.grad_fn().get());
    while (!open.empty()) {
      auto* node = open.back();
      open.pop_back();
      if (auto* leaf = dynamic_cast<torch::autograd::AccumulateGrad*>(node)) {
        if (!known.count(leaf->variable.unsafeGetTensorImpl())) {
          throw std::runtime_error("a block that is computed again reads a tensor with gradients that was not handed in");
        }
      }
      for (const auto& edge : node->next_edges()) visit(edge.function.get());
    }
  }
};

}  // namespace

extern "C" {

int rl_grad_enabled() { return at::GradMode::is_enabled() ? 1 : 0; }

// Puts a node behind `out`, computed without gradients from `read`: its backward pass calls `again`. `block` is given
// to `forget` once nothing needs it any more, at once if no gradient is asked for or something fails. `out` become
// tensors of their own.
int rl_recompute(at::Tensor* const* read, size_t n, at::Tensor* const* out, size_t made, Again again, Forget forget,
                 void* block) {
  std::shared_ptr<Recompute> node;
  const int code = guarded([&] {
    // Takes the block over: from here on the node forgets it.
    node = std::shared_ptr<Recompute>(new Recompute(again, forget, block), torch::autograd::deleteNode);
    torch::autograd::edge_list edges;
    bool any = false;
    for (size_t i = 0; i < n; ++i) {
      const bool wanted = read[i]->requires_grad();
      edges.push_back(wanted ? torch::autograd::impl::gradient_edge(*read[i]) : Edge());
      any = any || wanted;
    }
    if (!any) return;
    node->set_next_edges(std::move(edges));
    node->made = made;
    for (size_t i = 0; i < n; ++i) node->read.emplace_back(*read[i], false);
    for (size_t i = 0; i < made; ++i) {
      // An output may be an input, or share its numbers.
      *out[i] = out[i]->detach();
      if (at::isFloatingType(out[i]->scalar_type())) {
        torch::autograd::set_history(*out[i], node);
      } else {
        node->add_input_metadata(Node::undefined_input());
      }
    }
  });
  if (!node) forget(block);
  return code;
}

}  // extern "C"
