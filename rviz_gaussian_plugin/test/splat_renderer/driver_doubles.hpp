#pragma once

// Drivers that have less than the real one, refuse more, or count what is asked of them.

#include <epoxy/egl.h>
#include <epoxy/gl.h>

#include <algorithm>
#include <limits>
#include <map>
#include <string>
#include <type_traits>

namespace rosplat {

// A driver that is said to have buffers of a size, and subgroups of one or (0) none; notes the
// shaders that it gets.
class Disguise {
 public:
  Disguise(GLint64 largest_buffer, GLint subgroup_size) {
    largest_buffer_ = largest_buffer;
    subgroup_size_ = subgroup_size;
    epoxy_glGetInteger64v = [](GLenum name, GLint64* value) {
      real<PFNGLGETINTEGER64VPROC>("glGetInteger64v")(name, value);
      if (name == GL_MAX_SHADER_STORAGE_BLOCK_SIZE) *value = largest_buffer_;
    };
    epoxy_glGetIntegerv = [](GLenum name, GLint* value) {
      const bool subgroup =
          name >= GL_SUBGROUP_SIZE_KHR && name <= GL_SUBGROUP_SUPPORTED_FEATURES_KHR;
      if (!subgroup) return real<PFNGLGETINTEGERVPROC>("glGetIntegerv")(name, value);
      *value = name == GL_SUBGROUP_SIZE_KHR ? subgroup_size_ : ~0;
    };
    // The last of its extensions is another.
    epoxy_glGetStringi = [](GLenum name, GLuint index) {
      GLint count = 0;
      glGetIntegerv(GL_NUM_EXTENSIONS, &count);
      if (name == GL_EXTENSIONS && index + 1 == static_cast<GLuint>(count)) {
        return reinterpret_cast<const GLubyte*>("GL_KHR_shader_subgroup");
      }
      return real<PFNGLGETSTRINGIPROC>("glGetStringi")(name, index);
    };
    epoxy_glShaderSource = [](GLuint shader, GLsizei count, const GLchar* const* text,
                              const GLint* length) {
      GLint stage = 0;
      glGetShaderiv(shader, GL_SHADER_TYPE, &stage);
      noted.emplace(*text, static_cast<GLenum>(stage));
      real<PFNGLSHADERSOURCEPROC>("glShaderSource")(shader, count, text, length);
    };
  }
  ~Disguise() {
    epoxy_glGetInteger64v = real<PFNGLGETINTEGER64VPROC>("glGetInteger64v");
    epoxy_glGetIntegerv = real<PFNGLGETINTEGERVPROC>("glGetIntegerv");
    epoxy_glGetStringi = real<PFNGLGETSTRINGIPROC>("glGetStringi");
    epoxy_glShaderSource = real<PFNGLSHADERSOURCEPROC>("glShaderSource");
  }
  Disguise(const Disguise&) = delete;
  Disguise& operator=(const Disguise&) = delete;

  static inline std::map<std::string, GLenum> noted;  // their stages

 private:
  template <typename Function>
  static Function real(const char* name) {
    return reinterpret_cast<Function>(eglGetProcAddress(name));
  }

  static inline GLint64 largest_buffer_ = 0;
  static inline GLint subgroup_size_ = 0;
};

inline bool anyCall(...) { return true; }

// Counts the calls of a function of the driver, or those whose arguments `counts` wants.
template <auto* function, auto counts = anyCall>
class Calls {
 public:
  Calls() : real_(*function) {
    count_ = 0;
    driver_ = real_;
    *function = counting(real_);
  }
  ~Calls() { *function = real_; }
  Calls(const Calls&) = delete;
  Calls& operator=(const Calls&) = delete;

  static int count() { return count_; }

 private:
  using Pointer = std::remove_reference_t<decltype(*function)>;

  template <typename Result, typename... Args>
  static Pointer counting(Result (*)(Args...)) {
    return [](Args... args) {
      count_ += counts(args...);
      return driver_(args...);
    };
  }

  static inline int count_ = 0;
  static inline Pointer driver_ = nullptr;
  Pointer real_;
};
using Waits = Calls<&epoxy_glFinish>;  // for the graphics card

// A driver that refuses buffers of more bytes than a limit, if they are multiples of so many.
class BufferLimit {
 public:
  explicit BufferLimit(GLsizeiptr most = std::numeric_limits<GLsizeiptr>::max(),
                       GLsizeiptr multiple = 1)
      : before_(epoxy_glBufferData) {
    largest = 0;
    most_ = most;
    multiple_ = multiple;
    epoxy_glBufferData = [](GLenum target, GLsizeiptr bytes, const void* data, GLenum usage) {
      largest = std::max(largest, bytes);
      const bool refused = bytes > most_ && bytes % multiple_ == 0;
      reinterpret_cast<PFNGLBUFFERDATAPROC>(eglGetProcAddress("glBufferData"))(
          target, refused ? -1 : bytes, data, usage);
    };
  }
  ~BufferLimit() {
    epoxy_glBufferData = before_;
    most_ = std::numeric_limits<GLsizeiptr>::max();
  }
  BufferLimit(const BufferLimit&) = delete;
  BufferLimit& operator=(const BufferLimit&) = delete;

  static inline GLsizeiptr largest = 0;  // that was asked for

 private:
  static inline GLsizeiptr most_ = 0, multiple_ = 1;
  PFNGLBUFFERDATAPROC before_;
};

}  // namespace rosplat
