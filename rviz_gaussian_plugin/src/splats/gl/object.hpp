#pragma once

#include <epoxy/gl.h>

#include <cstdint>

namespace rosplat::gl {

// Whether objects of the current context can have labels, by which they are recognised later.
bool hasLabels();

// Owns a buffer, a texture or a query. Code that destroys a map, such as a slot of Qt, may have
// another context current, in which the same name is a different object: so the destructor only
// notes the object, and deleteAbandoned() deletes it. An object that has no label, or whose context
// is never current in such a call, goes with its context.
class Object {
 public:
  Object() = default;
  // kind: GL_BUFFER, GL_TEXTURE or GL_QUERY. Labels the object, which must have been bound once.
  Object(GLenum kind, GLuint id);
  Object(Object&& other) noexcept { *this = static_cast<Object&&>(other); }
  Object& operator=(Object&& other) noexcept;
  ~Object();

  GLuint id() const { return id_; }
  // Whether the object is one of the current context. Contexts share all but queries.
  bool isHere() const;
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
