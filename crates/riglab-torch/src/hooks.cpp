// Gradients told of while the backward pass goes on.

#include <ATen/ATen.h>
#include <stdexcept>

#include "shim.h"

extern "C" {

using rl_told = int (*)(void* context, size_t index, at::Tensor* gradient);

// Has `told` called as soon as the gradient of a leaf is complete, on the thread that computes it.
int rl_hook(at::Tensor* leaf, size_t index, rl_told told, void* context, unsigned* handle) {
  return guarded([&] {
    *handle = leaf->register_hook([=](at::Tensor gradient) {
      if (told(context, index, &gradient)) throw std::runtime_error("stopped by who listens to gradients");
    });
  });
}

int rl_unhook(at::Tensor* leaf, unsigned handle) {
  return guarded([&] { leaf->remove_hook(handle); });
}

}
