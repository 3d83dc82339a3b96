#include "gpu/group_sums.hpp"

namespace rosplat {

void GroupSums::reserve(std::size_t count) {
  const std::size_t before = words_.bytes();
  words_.reserve((1 + count) * sizeof(GLuint));
  if (words_.bytes() != before) words_.zero();
}

void GroupSums::run(const gl::Program& program, const Tally& count) {
  constexpr GLuint kRuns = 7;  // runs that look_back.glsl tells apart
  if (run_ == kRuns) {
    words_.zero();
    run_ = 0;
  }
  program.bind("Sums", words_);
  program.set("run", ++run_);
  if (!shaders_.groupsWait()) {
    program.set("announcing", 1);
    count.dispatchBlocks();
    gl::storageBarrier();
  }
  program.set("announcing", 0);
  count.dispatchBlocks();
  gl::storageBarrier();
}

void PrefixSum::run(const gl::Buffer& values, const Tally& count, const Tally& total,
                    std::size_t room, std::size_t each) {
  sum_.use();
  sum_.set("each", static_cast<GLuint>(each));
  sum_.set("room", static_cast<GLuint>(room));
  sum_.bind("Values", values);
  sum_.bind("Length", count.words());
  sum_.bind("Total", total.words());
  sums_.run(sum_, count);
  glMemoryBarrier(GL_COMMAND_BARRIER_BIT);  // the total is read by indirect dispatches
}

}  // namespace rosplat
