#pragma once

#include <epoxy/gl.h>

namespace rosplat::gl {

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
