#include "egl_context.hpp"

#include <array>
#include <stdexcept>

namespace rosplat {

EglContext::EglContext() {
  const auto fail = [](const char* why) {
    throw std::runtime_error(std::string("EGL gives no OpenGL without a display: ") + why);
  };
  if (!epoxy_has_egl()) fail("there is no libEGL (Debian: libegl1)");
  if (!epoxy_has_egl_extension(EGL_NO_DISPLAY, "EGL_EXT_platform_device"))
    fail("it has no devices");
  std::array<EGLDeviceEXT, 16> devices{};
  EGLint count = 0;
  eglQueryDevicesEXT(EGLint(devices.size()), devices.data(), &count);
  eglBindAPI(EGL_OPENGL_API);
  constexpr std::array<EGLint, 5> kWanted{EGL_SURFACE_TYPE, EGL_PBUFFER_BIT, EGL_RENDERABLE_TYPE,
                                          EGL_OPENGL_BIT, EGL_NONE};
  for (EGLint i = 0; i < count && !context_; ++i) {
    display_ = eglGetPlatformDisplayEXT(EGL_PLATFORM_DEVICE_EXT, devices[std::size_t(i)], nullptr);
    EGLConfig config = nullptr;
    EGLint configs = 0;
    if (!display_ || !eglInitialize(display_, nullptr, nullptr) ||
        !eglChooseConfig(display_, kWanted.data(), &config, 1, &configs) || configs < 1) {
      continue;
    }
    context_ = eglCreateContext(display_, config, EGL_NO_CONTEXT, nullptr);
  }
  if (!context_) fail("no device has it");
}

EglContext::~EglContext() { eglDestroyContext(display_, context_); }

void EglContext::enter() {
  mutex_.lock();
  if (entered_++ > 0) return;
  if (eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, context_)) return;
  --entered_;
  mutex_.unlock();
  throw std::runtime_error("EGL doesn't make its context current");
}

void EglContext::leave() {
  if (--entered_ == 0) {
    eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
  }
  mutex_.unlock();
}

}  // namespace rosplat
