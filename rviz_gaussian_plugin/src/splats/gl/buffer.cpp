#include "gl/buffer.hpp"

#include "gl/driver.hpp"

namespace rosplat::gl {

Buffer::Buffer(std::size_t bytes, GLenum usage) : bytes_(bytes) {
  dropErrors();
  GLuint id = 0;
  glGenBuffers(1, &id);
  glBindBuffer(GL_COPY_WRITE_BUFFER, id);
  object_ = Object(GL_BUFFER, id);
  glBufferData(GL_COPY_WRITE_BUFFER, static_cast<GLsizeiptr>(bytes), nullptr, usage);
  if (glGetError() != GL_NO_ERROR) {
    object_.release();
    throw Error("the graphics driver has no " + std::to_string(bytes >> 20) + " MiB left");
  }
}

void Buffer::write(std::size_t offset, const void* data, std::size_t bytes) {
  glBindBuffer(GL_COPY_WRITE_BUFFER, id());
  glBufferSubData(GL_COPY_WRITE_BUFFER, static_cast<GLintptr>(offset),
                  static_cast<GLsizeiptr>(bytes), data);
}

void Buffer::read(std::size_t offset, void* data, std::size_t bytes) const {
  glBindBuffer(GL_COPY_READ_BUFFER, id());
  glGetBufferSubData(GL_COPY_READ_BUFFER, static_cast<GLintptr>(offset),
                     static_cast<GLsizeiptr>(bytes), data);
}

void Buffer::reserve(std::size_t bytes, std::size_t more) {
  if (bytes_ >= bytes) return;
  release();  // first, so that the old and the new memory never exist at once
  *this = Buffer(bytes + more, GL_DYNAMIC_COPY);
  settle();
}

void Buffer::release() {
  object_.release();
  bytes_ = 0;
}

void Buffer::zero(std::size_t offset, std::size_t bytes) {
  glBindBuffer(GL_COPY_WRITE_BUFFER, id());
  glClearBufferSubData(GL_COPY_WRITE_BUFFER, GL_R32UI, static_cast<GLintptr>(offset),
                       static_cast<GLsizeiptr>(bytes), GL_RED_INTEGER, GL_UNSIGNED_INT, nullptr);
}

void Buffer::copy(const Buffer& from, std::size_t offset, std::size_t bytes, std::size_t to) {
  glBindBuffer(GL_COPY_READ_BUFFER, from.id());
  glBindBuffer(GL_COPY_WRITE_BUFFER, id());
  glCopyBufferSubData(GL_COPY_READ_BUFFER, GL_COPY_WRITE_BUFFER, static_cast<GLintptr>(offset),
                      static_cast<GLintptr>(to), static_cast<GLsizeiptr>(bytes));
}

// NVIDIA's driver (580) clears new buffers by itself, sometimes after later commands wrote to them.
void settle() { glFinish(); }

std::size_t largestStorageBuffer() {
  GLint64 bytes = 0;
  glGetInteger64v(GL_MAX_SHADER_STORAGE_BLOCK_SIZE, &bytes);
  return static_cast<std::size_t>(bytes);
}

void Slice::write(const void* data, std::size_t size) const {
  glBindBuffer(GL_COPY_WRITE_BUFFER, buffer);
  glBufferSubData(GL_COPY_WRITE_BUFFER, static_cast<GLintptr>(offset),
                  static_cast<GLsizeiptr>(size), data);
}

}  // namespace rosplat::gl
