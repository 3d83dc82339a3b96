#pragma once

#include <epoxy/egl.h>

// Where OpenGL draws without a window: Mesa's own way, else the first graphics card; EGL_NO_DISPLAY
// where there is neither.
inline EGLDisplay windowlessDisplay() {
  if (epoxy_has_egl_extension(EGL_NO_DISPLAY, "EGL_MESA_platform_surfaceless")) {
    return eglGetPlatformDisplayEXT(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, nullptr);
  }
  EGLDeviceEXT card = nullptr;
  EGLint cards = 0;
  if (!epoxy_has_egl_extension(EGL_NO_DISPLAY, "EGL_EXT_platform_device") ||
      !eglQueryDevicesEXT(1, &card, &cards) || cards == 0) {
    return EGL_NO_DISPLAY;
  }
  return eglGetPlatformDisplayEXT(EGL_PLATFORM_DEVICE_EXT, card, nullptr);
}
