#pragma once

#include <epoxy/gl.h>

#include <cstdint>

namespace rosplat::gl {

// Whether the current context's objects can be given labels, by which they are known again.
bool hasLabels();

// Owns a buffer, a texture or a query. Whoever destroys a map may have another context current, as
// in a slot of Qt's, where the same name is somebody else's: so what is destroyed is only noted,
// and deleted by deleteAbandoned(). What nobody comes for, or has no label, goes with its context.
class Object {
 public:
  Object() = default;
  // kind: GL_BUFFER, GL_TEXTURE or GL_QUERY. Labels the object, which must have been bound once.
  Object(GLenum kind, GLuint id);
  Object(Object&& other) noexcept { *this = static_cast<Object&&>(other); }
  Object& operator=(Object&& other) noexcept;
  ~Object();

  GLuint id() const { return id_; }
  // Whether it is one of the current context. Contexts share all but queries.
  bool isHere() const;
  // Deletes it at once: its context is current.
  void release();

 private:
  GLenum kind_ = 0;
  GLuint id_ = 0;
  std::uint64_t number_ = 0;  // of all objects that there ever were
};

// Deletes the abandoned objects of the context that is current.
void deleteAbandoned();

}  // namespace rosplat::gl
