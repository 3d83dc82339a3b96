#include "gl/upload_ring.hpp"

#include <utility>

#include "gl/driver.hpp"
#include "gl/readback.hpp"

namespace rosplat::gl {

namespace {

constexpr std::size_t kAlignment = 16;  // of each write [bytes]

bool isOver(GLsync fence) {
  const GLenum state = glClientWaitSync(fence, 0, 0);
  return state == GL_ALREADY_SIGNALED || state == GL_CONDITION_SATISFIED;
}

void renew(GLsync& fence) {
  if (fence) glDeleteSync(fence);
  fence = glFenceSync(GL_SYNC_GPU_COMMANDS_COMPLETE, 0);
}

}  // namespace

UploadRing::MappedBuffer UploadRing::makePart() {
  constexpr GLbitfield kAccess = GL_MAP_WRITE_BIT | GL_MAP_PERSISTENT_BIT | GL_MAP_COHERENT_BIT;
  const std::size_t bytes = std::max(kLeastBytes, bytes_);
  dropErrors();
  GLuint id = 0;
  glGenBuffers(1, &id);
  glBindBuffer(GL_COPY_READ_BUFFER, id);
  MappedBuffer part{Object(GL_BUFFER, id), bytes, nullptr, nullptr};
  const auto size = static_cast<GLsizeiptr>(bytes);
  glBufferStorage(GL_COPY_READ_BUFFER, size, nullptr, kAccess);
  settle();
  part.memory = static_cast<std::uint8_t*>(glMapBufferRange(GL_COPY_READ_BUFFER, 0, size, kAccess));
  if (!part.memory) {
    part.buffer.release();
    throw Error("the graphics driver has no memory left to upload from");
  }
  bytes_ += bytes;
  return part;
}

void* UploadRing::room(std::size_t bytes) {
  if (part_.memory && part_.bytes - used_ < bytes) {
    renew(part_.read);
    busy_.push_back(std::exchange(part_, {}));
  }
  if (!part_.memory) {
    if (busy_.empty() || (bytes_ < kMostBytes && !isOver(busy_.front().read))) {
      part_ = makePart();
    } else {
      waitFor(busy_.front().read);
      part_ = std::move(busy_.front());
      busy_.pop_front();
    }
    used_ = 0;
  }
  return part_.memory + used_;
}

void UploadRing::copy(const Buffer& to, std::size_t offset, std::size_t bytes) {
  glBindBuffer(GL_COPY_READ_BUFFER, part_.buffer.id());
  glBindBuffer(GL_COPY_WRITE_BUFFER, to.id());
  glCopyBufferSubData(GL_COPY_READ_BUFFER, GL_COPY_WRITE_BUFFER, static_cast<GLintptr>(used_),
                      static_cast<GLintptr>(offset), static_cast<GLsizeiptr>(bytes));
  markInUse(bytes);
}

void UploadRing::markInUse(std::size_t bytes) {
  used_ = std::min(part_.bytes, (used_ + bytes + kAlignment - 1) / kAlignment * kAlignment);
}

void UploadRing::close() { renew(closed_); }

void UploadRing::await() const {
  if (closed_) glWaitSync(closed_, 0, GL_TIMEOUT_IGNORED);
}

}  // namespace rosplat::gl
