#pragma once

#include <epoxy/gl.h>

namespace rosplat::gl {

// Within the scope, programs compute and buffers are written. The end restores the program that
// Ogre believes is in use, and unbinds what Ogre doesn't know of: a context that draws no more
// would keep it in memory.
class ComputeScope {
 public:
  ComputeScope() { glGetIntegerv(GL_CURRENT_PROGRAM, &program_); }
  ~ComputeScope();
  ComputeScope(const ComputeScope&) = delete;
  ComputeScope& operator=(const ComputeScope&) = delete;

 private:
  GLint program_ = 0;
};

// The same for drawing: the end restores all that Ogre believes is set. It takes the driver three
// times as long.
class StateGuard {
 public:
  StateGuard();
  ~StateGuard();
  StateGuard(const StateGuard&) = delete;
  StateGuard& operator=(const StateGuard&) = delete;

  GLuint drawFramebuffer() const { return draw_framebuffer_; }

 private:
  ComputeScope compute_;
  bool framebuffers_, vertex_arrays_, sampled_textures_;  // whether the context has these
  GLint vertex_array_ = 0, array_buffer_ = 0;
  GLint active_texture_ = 0, texture_ = 0, sampled_texture_ = 0;
  GLuint draw_framebuffer_ = 0, read_framebuffer_ = 0;
};

// Has contexts that share objects take turns: the commands of a Turn wait for those of the last
// one, which may be another context's.
class Turn {
 public:
  // over: belongs to what is shared, null before the first turn. goes_on: the last turn was this
  // context's, too, so there is nothing to wait for.
  explicit Turn(GLsync& over, bool goes_on = false) : over_(over) {
    if (over_ && !goes_on) glWaitSync(over_, 0, GL_TIMEOUT_IGNORED);
  }
  Turn(const Turn&) = delete;
  Turn& operator=(const Turn&) = delete;
  ~Turn() {
    if (over_) glDeleteSync(over_);
    over_ = glFenceSync(GL_SYNC_GPU_COMMANDS_COMPLETE, 0);
  }

 private:
  GLsync& over_;
};

}  // namespace rosplat::gl
