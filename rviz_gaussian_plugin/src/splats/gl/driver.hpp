#pragma once

#include <epoxy/gl.h>

#include <stdexcept>
#include <string>

// All functions run in the render thread, with the context current.
namespace rosplat::gl {

// Thrown if the driver refuses something: a shader, memory, a framebuffer.
struct Error : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// As many storage buffers as shaders bind.
constexpr GLint kStorageBindings = 16;

// Discards OpenGL's pending errors.
void dropErrors();

// Whether the current context has framebuffer objects.
bool hasFramebuffers();

// Whether a graphics card draws in the current context, not the processor.
bool accelerated();

// Whether OpenGL is drawn by the processor because the user has told Mesa so.
bool emulationIsWanted();

// An empty string where the current context can draw splats, else a sentence for the user.
std::string unsupported();

}  // namespace rosplat::gl
