#pragma once

#include <epoxy/gl.h>

#include <array>
#include <cstddef>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "gl/object.hpp"

// Owners of OpenGL objects. All functions run in the render thread, with the context current.
namespace rosplat::gl {

// Thrown if the driver refuses something: a shader, memory, a framebuffer.
struct Error : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// A buffer object with immutable size.
class Buffer {
 public:
  Buffer() = default;
  // Callers call settle() before they write. Throws Error if the driver has no memory.
  Buffer(std::size_t bytes, GLenum usage);

  GLuint id() const { return object_.id(); }
  std::size_t bytes() const { return bytes_; }
  void write(std::size_t offset, const void* data, std::size_t bytes);
  // Waits for the graphics card.
  void read(std::size_t offset, void* data, std::size_t bytes) const;
  void zero() { zero(0, bytes_); }
  void zero(std::size_t offset, std::size_t bytes);  // whole words
  // Copies `bytes` bytes of another buffer, from `offset` on, to the byte `to` of this one.
  void copy(const Buffer& from, std::size_t offset, std::size_t bytes, std::size_t to = 0);
  // Makes room for so many bytes, and if it grows for some more: growing waits for the graphics
  // card. The content is lost if the buffer grows.
  void reserve(std::size_t bytes, std::size_t more = 0);
  // Frees the memory.
  void release();
  // Makes room for the values and writes them to the start of the buffer.
  template <typename Value>
  void upload(const std::vector<Value>& values) {
    const std::size_t bytes = values.size() * sizeof(Value);
    reserve(bytes, bytes / 8);
    write(0, values.data(), bytes);
  }

 private:
  Object object_;
  std::size_t bytes_ = 0;
};

// Waits until the driver has finished making new buffers.
void settle();

// The largest buffer that a shader can read. [bytes]
std::size_t largestStorageBuffer();

// A part of a buffer for a shader to bind.
struct Slice {
  static constexpr std::size_t kAlignment = 256;  // of `offset`, for every driver [bytes]

  GLuint buffer = 0;
  std::size_t offset = 0, bytes = 0;

  void write(const void* data, std::size_t size) const;
};

// Waits until a fence is passed. Throws Error if the graphics card doesn't answer for a minute.
void waitFor(GLsync fence);

// Words for the CPU, which waits for these alone: the graphics card goes on. Callers call settle()
// before the first write.
class Readback {
 public:
  explicit Readback(std::size_t words);

  // Submits a copy: of a buffer as the commands submitted so far leave it.
  void ask(const Buffer& buffer) { ask(buffer, 0, buffer.bytes()); }
  // The same of `bytes` bytes of it, from `offset` on, to the byte `to` of this.
  void ask(const Buffer& buffer, std::size_t offset, std::size_t bytes, std::size_t to = 0);
  // For a shader that writes the words: call written() after its dispatch.
  Slice slice() const { return {copy_.id(), 0, bytes_}; }
  void written();
  // Waits for the last ask() or written(), and returns the words. Throws as waitFor().
  const GLuint* wait() const;
  std::size_t bytes() const { return bytes_; }

 private:
  void renewFence();

  Object copy_;
  std::size_t bytes_;
  const GLuint* mapped_ = nullptr;
  GLsync copied_ = nullptr;  // the destructor leaves it to its context
};

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

// Discards OpenGL's pending errors.
void dropErrors();

// Returns the format of a texture that a framebuffer's depth can be copied to, 0 without a depth.
// Binds the framebuffer for reading.
GLenum depthFormat(GLuint framebuffer);

// A single-sample colour texture with a depth texture and, if second_format isn't 0, a second
// colour texture.
class Target {
 public:
  Target() = default;
  Target(GLenum color_format, int width, int height, GLenum depth_format = GL_DEPTH24_STENCIL8,
         GLenum second_format = 0);

  // Makes the textures anew unless they have these formats and this size. Returns whether it did.
  bool become(GLenum color_format, int width, int height, GLenum depth_format = GL_DEPTH24_STENCIL8,
              GLenum second_format = 0);

  GLuint color() const { return color_.id(); }
  GLuint second() const { return second_.id(); }
  GLuint depth() const { return depth_.id(); }
  GLenum format() const { return format_; }
  GLenum depthFormat() const { return depth_format_; }
  int width() const { return width_; }
  int height() const { return height_; }
  std::size_t bytes() const { return bytes_; }

 private:
  Object color_, second_, depth_;
  GLenum format_ = 0, depth_format_ = 0;
  int width_ = 0, height_ = 0;
  std::size_t bytes_ = 0;
};

// A framebuffer and a vertex array for the duration of a scope: contexts share textures and
// buffers, but not framebuffers and vertex arrays, and rviz has a context for each window.
class DrawScope {
 public:
  explicit DrawScope(const Target& target);
  ~DrawScope();
  DrawScope(const DrawScope&) = delete;
  DrawScope& operator=(const DrawScope&) = delete;

  GLuint framebuffer() const { return framebuffer_; }

 private:
  GLuint framebuffer_ = 0, vertex_array_ = 0;
};

// A depth texture with as many samples a pixel as a window has.
class SampledDepth {
 public:
  SampledDepth() = default;
  SampledDepth(int width, int height, int samples);

  GLuint texture() const { return texture_.id(); }
  int width() const { return width_; }
  int height() const { return height_; }
  int samples() const { return samples_; }
  std::size_t bytes() const { return bytes_; }

 private:
  Object texture_;
  int width_ = 0, height_ = 0, samples_ = 0;
  std::size_t bytes_ = 0;
};

// Within the scope, all that Ogre draws leaves its depth alone, in a texture that is cleared first.
class DepthScope {
 public:
  explicit DepthScope(const SampledDepth& depth);
  ~DepthScope();
  DepthScope(const DepthScope&) = delete;
  DepthScope& operator=(const DepthScope&) = delete;

 private:
  GLuint framebuffer_ = 0;
  GLint draw_framebuffer_ = 0, read_framebuffer_ = 0;
  std::array<GLint, 4> viewport_{};
};

// Whether the current context has framebuffer objects.
bool hasFramebuffers();

// Within the scope, pixels go to and come from plain memory, whatever buffers and offsets were set.
class PixelScope {
 public:
  PixelScope();
  ~PixelScope();
  PixelScope(const PixelScope&) = delete;
  PixelScope& operator=(const PixelScope&) = delete;

 private:
  GLint pack_buffer_ = 0, unpack_buffer_ = 0;
};

// A framebuffer of depths alone. The constructor binds it.
class DepthFramebuffer {
 public:
  DepthFramebuffer(GLenum format, int width, int height);
  ~DepthFramebuffer();
  DepthFramebuffer(const DepthFramebuffer&) = delete;
  DepthFramebuffer& operator=(const DepthFramebuffer&) = delete;

  GLuint id() const { return id_; }

 private:
  GLuint id_ = 0, depths_ = 0;
};

// Returns window depths of the framebuffer that is bound for reading, the picture's top row first.
// top_first: the framebuffer's first row is the picture's top.
std::vector<float> readDepths(int x, int y, int width, int height, bool top_first);

// Returns the RGBA colour of the framebuffer that is bound for reading, in its order of rows.
std::vector<float> readPixels(int width, int height);

// Within the scope, programs compute and buffers are written. The end restores the program that
// Ogre believes is in use, and unbinds what Ogre doesn't know of: a context that draws no more
// would keep it in memory.
class ComputeScope {
 public:
  ComputeScope() { glGetIntegerv(GL_CURRENT_PROGRAM, &program_); }
  ~ComputeScope();
  ComputeScope(const ComputeScope&) = delete;
  ComputeScope& operator=(const ComputeScope&) = delete;

 private:
  GLint program_ = 0;
};

// The same for drawing: the end restores all that Ogre believes is set. It takes the driver three
// times as long.
class StateGuard {
 public:
  StateGuard();
  ~StateGuard();
  StateGuard(const StateGuard&) = delete;
  StateGuard& operator=(const StateGuard&) = delete;

  GLuint drawFramebuffer() const { return draw_framebuffer_; }

 private:
  ComputeScope compute_;
  bool framebuffers_, vertex_arrays_, sampled_textures_;  // whether the context has these
  GLint vertex_array_ = 0, array_buffer_ = 0;
  GLint active_texture_ = 0, texture_ = 0, sampled_texture_ = 0;
  GLuint draw_framebuffer_ = 0, read_framebuffer_ = 0;
};

// Measures times on the graphics card. laps() waits for the card: run one only for a profile.
class Stopwatch {
 public:
  explicit Stopwatch(bool running) : running_(running) { lap(""); }
  ~Stopwatch();
  Stopwatch(const Stopwatch&) = delete;
  Stopwatch& operator=(const Stopwatch&) = delete;

  // Ends a lap and names it.
  void lap(const char* name);
  // The laps so far, by name [s].
  std::map<std::string, double> laps() const;

 private:
  bool running_;
  std::vector<std::pair<const char*, GLuint>> queries_;
};

// Whether a graphics card draws in the current context, not the processor.
bool accelerated();

// An empty string where the current context can draw splats, else a sentence for the user.
std::string unsupported();

}  // namespace rosplat::gl
