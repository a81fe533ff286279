// What the files of the shim share: errors of libtorch become a code, and a message kept for `rl_error`.

#pragma once

#include <ATen/CPUGeneratorImpl.h>
#include <ATen/core/Generator.h>
#include <c10/util/Exception.h>
#include <exception>
#include <string>

inline thread_local std::string last_error;

// A thread's own generator, if it has one.
inline thread_local at::Generator own_generator;

// Where this thread's random numbers come from.
inline at::Generator cpu_generator() {
  return own_generator.defined() ? own_generator : at::detail::getDefaultCPUGenerator();
}

template <typename F>
int guarded(F body) {
  try {
    body();
    return 0;
  } catch (const c10::Error& e) {
    last_error = e.what_without_backtrace();
  } catch (const std::exception& e) {
    last_error = e.what();
  } catch (...) {
    last_error = "unknown C++ exception";
  }
  return 1;
}
