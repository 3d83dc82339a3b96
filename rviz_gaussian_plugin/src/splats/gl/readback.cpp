#include "gl/readback.hpp"

#include "gl/driver.hpp"

namespace rosplat::gl {

void waitFor(GLsync fence) {
  constexpr GLuint64 kMinute = 60'000'000'000;  // [ns]; no frame takes as long, even in software
  const GLenum state = glClientWaitSync(fence, GL_SYNC_FLUSH_COMMANDS_BIT, kMinute);
  if (state == GL_TIMEOUT_EXPIRED || state == GL_WAIT_FAILED) {
    throw Error("the graphics card doesn't answer any more");
  }
}

Readback::Readback(std::size_t words) : bytes_(words * sizeof(GLuint)) {
  const auto bytes = static_cast<GLsizeiptr>(bytes_);
  constexpr GLbitfield kAccess = GL_MAP_READ_BIT | GL_MAP_PERSISTENT_BIT | GL_MAP_COHERENT_BIT;
  GLuint id = 0;
  glGenBuffers(1, &id);
  glBindBuffer(GL_COPY_WRITE_BUFFER, id);
  copy_ = Object(GL_BUFFER, id);
  glBufferStorage(GL_COPY_WRITE_BUFFER, bytes, nullptr, kAccess);
  mapped_ = static_cast<const GLuint*>(glMapBufferRange(GL_COPY_WRITE_BUFFER, 0, bytes, kAccess));
  if (!mapped_) throw Error("the graphics driver maps no buffers");
}

void Readback::ask(const Buffer& buffer, std::size_t offset, std::size_t bytes, std::size_t to) {
  glBindBuffer(GL_COPY_READ_BUFFER, buffer.id());
  glBindBuffer(GL_COPY_WRITE_BUFFER, copy_.id());
  glCopyBufferSubData(GL_COPY_READ_BUFFER, GL_COPY_WRITE_BUFFER, static_cast<GLintptr>(offset),
                      static_cast<GLintptr>(to), static_cast<GLsizeiptr>(bytes));
  renewFence();
}

void Readback::written() {
  glMemoryBarrier(GL_CLIENT_MAPPED_BUFFER_BARRIER_BIT);
  renewFence();
}

void Readback::renewFence() {
  if (copied_) glDeleteSync(copied_);
  copied_ = glFenceSync(GL_SYNC_GPU_COMMANDS_COMPLETE, 0);
}

const GLuint* Readback::wait() const {
  waitFor(copied_);
  return mapped_;
}

}  // namespace rosplat::gl
