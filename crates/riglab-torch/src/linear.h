// Affine maps of rows for nodes that bring their own backward pass: by the library that `rl_linear` takes for them.

#pragma once

#include <ATen/ATen.h>
#include <optional>

// x [m, k] to x wᵀ + bias [m, n], of CPU tensors in f32.
at::Tensor affine_rows(const at::Tensor& x, const at::Tensor& w, const std::optional<at::Tensor>& bias);

// The gradient of x, from that of the result [m, n].
at::Tensor affine_rows_back(const at::Tensor& grad, const at::Tensor& w);
