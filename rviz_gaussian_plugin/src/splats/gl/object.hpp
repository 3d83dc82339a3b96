#pragma once

#include <epoxy/gl.h>

#include <cstdint>

namespace rosplat::gl {

// Whether objects of the current context can have labels, by which they are recognised later.
bool hasLabels();

// Owns a buffer or a texture. Code that destroys a map, such as a slot of Qt, may have
// another context current, in which the same name is a different object: so the destructor only
// notes the object, and deleteAbandoned() deletes it. An object that has no label, or whose context
// is never current in such a call, goes with its context.
class Object {
 public:
  Object() = default;
  // kind: GL_BUFFER or GL_TEXTURE. Labels the object, which must have been bound once.
  Object(GLenum kind, GLuint id);
  Object(Object&& other) noexcept { *this = static_cast<Object&&>(other); }
  Object& operator=(Object&& other) noexcept;
  ~Object();

  GLuint id() const { return id_; }
  // Deletes the object at once. Its context must be current.
  void release();

 private:
  GLenum kind_ = 0;
  GLuint id_ = 0;
  std::uint64_t number_ = 0;  // unique among all objects that there ever were
};

// Deletes the abandoned objects of the context that is current.
void deleteAbandoned();

}  // namespace rosplat::gl
