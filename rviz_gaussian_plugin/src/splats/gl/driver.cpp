#include "gl/driver.hpp"

#include <cstdlib>
#include <string_view>

namespace rosplat::gl {

void dropErrors() {
  // Not until no error is left: without a context, drivers always return one.
  for (int i = 0; i < 16 && glGetError() != GL_NO_ERROR; ++i) {
  }
}

bool hasFramebuffers() {
  return epoxy_gl_version() >= 30 || epoxy_has_gl_extension("GL_ARB_framebuffer_object");
}

bool accelerated() {
  const auto* name = reinterpret_cast<const char*>(glGetString(GL_RENDERER));
  const std::string_view renderer = name ? name : "";
  for (const char* software : {"llvmpipe", "softpipe", "swrast", "SWR", "Software"}) {
    if (renderer.find(software) != std::string_view::npos) return false;
  }
  return true;
}

bool emulationIsWanted() {
  const char* wanted = std::getenv("LIBGL_ALWAYS_SOFTWARE");
  const std::string_view value = wanted ? wanted : "";
  return value == "1" || value == "true";
}

std::string unsupported() {
  const int version = epoxy_gl_version();
  const auto* renderer = reinterpret_cast<const char*>(glGetString(GL_RENDERER));
  const std::string driver = std::string(" (driver: ") + (renderer ? renderer : "unknown") + ")";
  if (!epoxy_is_desktop_gl() || version < 44) {
    return "OpenGL 4.4 is needed to draw splats, this is " + std::to_string(version / 10) + "." +
           std::to_string(version % 10) + driver + "; update the graphics driver";
  }
  GLint compute_buffers = 0;
  glGetIntegerv(GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS, &compute_buffers);
  if (compute_buffers < kStorageBindings) {
    return "the graphics driver gives a compute shader " + std::to_string(compute_buffers) +
           " storage buffers, " + std::to_string(kStorageBindings) + " are needed" + driver;
  }
  return {};
}

}  // namespace rosplat::gl
