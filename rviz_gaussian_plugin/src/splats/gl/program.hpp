#pragma once

#include <epoxy/gl.h>

#include <array>
#include <cstddef>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "gl/buffer.hpp"

namespace rosplat::gl {

// A linked program. Uniforms are set and storage blocks are bound by name; names that the program
// lacks have no effect. The OpenGL program of a destroyed Program is kept for the next one of the
// same sources: drivers (Mesa 22.3's llvmpipe) crash if a program is deleted that another context
// used.
class Program {
 public:
  Program() = default;
  Program(Program&& other) noexcept { *this = std::move(other); }
  Program& operator=(Program&& other) noexcept;
  ~Program();

  void attach(GLenum stage, const std::string& name, const std::string& source);
  // Throws Error with the driver's log.
  void link(const std::string& name);

  void use() const { glUseProgram(id_); }
  // Bind a buffer to a storage block. The program need not be in use.
  void bind(std::string_view block, const Buffer& buffer) const;
  void bind(std::string_view block, const Slice& slice) const;

  GLint at(const char* uniform) const;
  void set(const char* uniform, int value) const { glUniform1i(at(uniform), value); }
  void set(const char* uniform, GLuint value) const { glUniform1ui(at(uniform), value); }
  void set(const char* uniform, float value) const { glUniform1f(at(uniform), value); }
  void set(const char* uniform, double x, double y) const {
    glUniform2f(at(uniform), static_cast<float>(x), static_cast<float>(y));
  }
  void set(const char* uniform, const std::array<GLint, 4>& v) const {
    glUniform4iv(at(uniform), 1, v.data());
  }

 private:
  struct Shader {
    GLenum stage;
    std::string name, source;
  };

  void compile(const Shader& shader) const;
  void numberBlocks();
  std::optional<GLuint> binding(std::string_view block) const;

  GLuint id_ = 0;
  mutable std::map<std::string, GLint, std::less<>> locations_;
  std::vector<std::string> blocks_;  // storage blocks, by binding
  std::vector<Shader> shaders_;      // attached, until they are linked
  std::string label_;                // identifies the sources of the linked program
};

// Runs the compute program in use in at least so many work groups, in two dimensions where there
// are many.
void dispatch(std::size_t work_groups);
// Runs it in at least so many invocations, 256 a work group.
void dispatchInvocations(std::size_t invocations);

// Makes writes to storage buffers visible to later shaders, and to later copies and reads.
void storageBarrier();

}  // namespace rosplat::gl
