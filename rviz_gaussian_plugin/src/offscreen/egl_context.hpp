#pragma once

#include <epoxy/egl.h>

#include <mutex>

namespace rosplat {

// An OpenGL context without a window and without a display, of the first device that EGL has one
// for. Any thread may enter it: it waits for the thread that is in it.
class EglContext {
 public:
  // Throws std::runtime_error with a sentence for the user.
  EglContext();
  EglContext(const EglContext&) = delete;
  EglContext& operator=(const EglContext&) = delete;
  ~EglContext();

  // Makes it current until leave(). A thread that is in it may enter it again.
  void enter();
  void leave();

  // enter() and leave(), as a scope.
  struct Scope {
    explicit Scope(EglContext& of) : context(of) { context.enter(); }
    Scope(const Scope&) = delete;
    Scope& operator=(const Scope&) = delete;
    ~Scope() { context.leave(); }

    EglContext& context;
  };

 private:
  EGLDisplay display_ = EGL_NO_DISPLAY;
  EGLContext context_ = EGL_NO_CONTEXT;
  std::recursive_mutex mutex_;
  int entered_ = 0;  // times, by the thread that has `mutex_`
};

}  // namespace rosplat
