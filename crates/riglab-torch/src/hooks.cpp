// Gradients told of while the backward pass goes on. As in shim.cpp, functions return 0, or 1 with the message kept.

#include <ATen/ATen.h>
#include <c10/util/Exception.h>
#include <stdexcept>

int rl_keep_error(const char* message);

extern "C" {

using rl_told = int (*)(void* context, size_t index, at::Tensor* gradient);

// Has `told` called as soon as the gradient of a leaf is complete, on the thread that computes it.
int rl_hook(at::Tensor* leaf, size_t index, rl_told told, void* context, unsigned* handle) {
  try {
    *handle = leaf->register_hook([=](at::Tensor gradient) {
      if (told(context, index, &gradient)) throw std::runtime_error("stopped by who listens to gradients");
    });
    return 0;
  } catch (const c10::Error& e) {
    return rl_keep_error(e.what_without_backtrace());
  } catch (const std::exception& e) {
    return rl_keep_error(e.what());
  }
}

int rl_unhook(at::Tensor* leaf, unsigned handle) {
  try {
    leaf->remove_hook(handle);
    return 0;
  } catch (const c10::Error& e) {
    return rl_keep_error(e.what_without_backtrace());
  } catch (const std::exception& e) {
    return rl_keep_error(e.what());
  }
}

}
