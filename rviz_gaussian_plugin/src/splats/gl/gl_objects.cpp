#include "gl/gl_objects.hpp"

#include <algorithm>
#include <array>
#include <functional>
#include <map>
#include <string_view>
#include <vector>

namespace rosplat::gl {

namespace {
constexpr GLint kStorageBindings = 16, kImageUnits = 3;  // as many as shaders use
}

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

namespace {

// OpenGL programs of destroyed Program objects, by label.
std::multimap<std::string, GLuint>& retiredPrograms() {
  static std::multimap<std::string, GLuint> programs;
  return programs;
}

std::string labelOf(GLuint program) {
  std::array<char, 64> label{};
  if (hasLabels() && glIsProgram(program)) {
    glGetObjectLabel(GL_PROGRAM, program, static_cast<GLsizei>(label.size()), nullptr,
                     label.data());
  }
  return label.data();
}

// Returns 0 if there is none. Drops programs of contexts that are gone: their labels are lost.
GLuint takeRetired(const std::string& label) {
  auto& retired = retiredPrograms();
  for (auto found = retired.find(label); found != retired.end(); found = retired.find(label)) {
    const GLuint program = found->second;
    retired.erase(found);
    if (labelOf(program) == label) return program;
  }
  return 0;
}

}  // namespace

Program& Program::operator=(Program&& other) noexcept {
  std::swap(id_, other.id_);
  std::swap(locations_, other.locations_);
  std::swap(blocks_, other.blocks_);
  std::swap(shaders_, other.shaders_);
  std::swap(label_, other.label_);
  return *this;
}

Program::~Program() {
  if (id_) retiredPrograms().emplace(label_, id_);
}

void Program::attach(GLenum stage, const std::string& name, const std::string& source) {
  shaders_.push_back({stage, name, source});
}

void Program::compile(const Shader& from) const {
  const GLuint shader = glCreateShader(from.stage);
  const char* text = from.source.c_str();
  glShaderSource(shader, 1, &text, nullptr);
  glCompileShader(shader);
  GLint ok = 0, length = 0;
  glGetShaderiv(shader, GL_COMPILE_STATUS, &ok);
  if (!ok) {
    glGetShaderiv(shader, GL_INFO_LOG_LENGTH, &length);
    std::vector<char> log(static_cast<std::size_t>(length) + 1);
    glGetShaderInfoLog(shader, length, nullptr, log.data());
    glDeleteShader(shader);
    throw Error(from.name + " does not compile: " + log.data());
  }
  glAttachShader(id_, shader);
  glDeleteShader(shader);  // lives as long as the program
}

void Program::link(const std::string& name) {
  std::size_t hash = 0;
  for (const Shader& shader : shaders_) {
    hash = 31 * hash + std::hash<std::string>()(shader.source) + shader.stage;
  }
  label_ = name.substr(0, 32) + " " + std::to_string(hash);
  const std::vector<Shader> shaders = std::move(shaders_);
  id_ = takeRetired(label_);
  if (id_) return numberBlocks();
  id_ = glCreateProgram();
  for (const Shader& shader : shaders) compile(shader);
  glLinkProgram(id_);
  GLint ok = 0, length = 0;
  glGetProgramiv(id_, GL_LINK_STATUS, &ok);
  if (!ok) {
    glGetProgramiv(id_, GL_INFO_LOG_LENGTH, &length);
    std::vector<char> log(static_cast<std::size_t>(length) + 1);
    glGetProgramInfoLog(id_, length, nullptr, log.data());
    throw Error(name + " does not link: " + log.data());
  }
  if (hasLabels()) glObjectLabel(GL_PROGRAM, id_, -1, label_.c_str());
  numberBlocks();
}

void Program::numberBlocks() {
  if (epoxy_gl_version() < 43) return;  // without storage blocks
  GLint count = 0;
  glGetProgramInterfaceiv(id_, GL_SHADER_STORAGE_BLOCK, GL_ACTIVE_RESOURCES, &count);
  for (GLuint block = 0; block < static_cast<GLuint>(count); ++block) {
    std::array<char, 64> name{};
    glGetProgramResourceName(id_, GL_SHADER_STORAGE_BLOCK, block, GLsizei(name.size()), nullptr,
                             name.data());
    glShaderStorageBlockBinding(id_, block, block);
    blocks_.emplace_back(name.data());
  }
}

std::optional<GLuint> Program::binding(std::string_view block) const {
  const auto found = std::find(blocks_.begin(), blocks_.end(), block);
  if (found == blocks_.end()) return std::nullopt;
  return static_cast<GLuint>(found - blocks_.begin());
}

void Program::bind(std::string_view block, const Buffer& buffer) const {
  if (const auto at = binding(block)) {
    glBindBufferBase(GL_SHADER_STORAGE_BUFFER, *at, buffer.id());
  }
}

void Program::bind(std::string_view block, const Slice& slice) const {
  if (const auto at = binding(block)) {
    glBindBufferRange(GL_SHADER_STORAGE_BUFFER, *at, slice.buffer,
                      static_cast<GLintptr>(slice.offset), static_cast<GLsizeiptr>(slice.bytes));
  }
}

GLint Program::at(const char* uniform) const {
  const auto found = locations_.find(uniform);
  if (found != locations_.end()) return found->second;
  return locations_.emplace(uniform, glGetUniformLocation(id_, uniform)).first->second;
}

void dispatch(std::size_t work_groups) {
  constexpr std::size_t kMost = 65535;  // in a dimension; every driver takes as many
  const std::size_t rows = (work_groups + kMost - 1) / kMost;
  if (rows == 0) return;
  glDispatchCompute(static_cast<GLuint>((work_groups + rows - 1) / rows), static_cast<GLuint>(rows),
                    1);
}

void dispatchInvocations(std::size_t invocations) { dispatch((invocations + 255) / 256); }

void storageBarrier() {
  glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT | GL_BUFFER_UPDATE_BARRIER_BIT);
}

void dropErrors() {
  // Not until no error is left: without a context, drivers always return one.
  for (int i = 0; i < 16 && glGetError() != GL_NO_ERROR; ++i) {
  }
}

bool hasFramebuffers() {
  return epoxy_gl_version() >= 30 || epoxy_has_gl_extension("GL_ARB_framebuffer_object");
}

GLenum depthFormat(GLuint framebuffer) {
  if (!hasFramebuffers()) {
    GLint bits = 0;
    glGetIntegerv(GL_DEPTH_BITS, &bits);
    return bits > 0 ? GL_DEPTH24_STENCIL8 : 0;
  }
  glBindFramebuffer(GL_READ_FRAMEBUFFER, framebuffer);
  const GLenum attachment = framebuffer == 0 ? GL_DEPTH : GL_DEPTH_ATTACHMENT;
  const auto ask = [attachment](GLenum what) {
    GLint value = 0;
    glGetFramebufferAttachmentParameteriv(GL_READ_FRAMEBUFFER, attachment, what, &value);
    return value;
  };
  if (ask(GL_FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE) == GL_NONE) return 0;
  const GLint bits = ask(GL_FRAMEBUFFER_ATTACHMENT_DEPTH_SIZE);
  if (ask(GL_FRAMEBUFFER_ATTACHMENT_COMPONENT_TYPE) == GL_FLOAT) {
    return ask(GL_FRAMEBUFFER_ATTACHMENT_STENCIL_SIZE) > 0 ? GL_DEPTH32F_STENCIL8
                                                           : GL_DEPTH_COMPONENT32F;
  }
  return bits == 16   ? GL_DEPTH_COMPONENT16
         : bits == 32 ? GL_DEPTH_COMPONENT32
                      : GL_DEPTH24_STENCIL8;
}

namespace {

std::size_t pixelBytes(GLenum format) {
  switch (format) {
    case GL_RGBA32F:
      return 16;
    case GL_DEPTH_COMPONENT16:
      return 2;
    case GL_DEPTH24_STENCIL8:
    case GL_DEPTH_COMPONENT32:
    case GL_DEPTH_COMPONENT32F:
      return 4;
    default:
      return 8;
  }
}

}  // namespace

Target::Target(GLenum color_format, int width, int height, GLenum depth_format,
               GLenum second_format)
    : format_(color_format), depth_format_(depth_format), width_(width), height_(height) {
  const auto texture = [&](GLenum format) {
    GLuint id = 0;
    glGenTextures(1, &id);
    glBindTexture(GL_TEXTURE_2D, id);
    glTexStorage2D(GL_TEXTURE_2D, 1, format, width, height);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
    bytes_ +=
        pixelBytes(format) * static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    return Object(GL_TEXTURE, id);
  };
  color_ = texture(color_format);
  if (second_format) second_ = texture(second_format);
  depth_ = texture(depth_format);
}

bool Target::become(GLenum color_format, int width, int height, GLenum depth_format,
                    GLenum second_format) {
  if (format_ == color_format && width_ == width && height_ == height &&
      depth_format_ == depth_format && (second() != 0) == (second_format != 0)) {
    return false;
  }
  for (Object* texture : {&color_, &second_, &depth_}) {
    texture->release();  // first, so that the old and the new memory never exist at once
  }
  *this = Target(color_format, width, height, depth_format, second_format);
  return true;
}

DrawScope::DrawScope(const Target& target) {
  glGenFramebuffers(1, &framebuffer_);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, target.color(), 0);
  const bool stencil =
      target.depthFormat() == GL_DEPTH24_STENCIL8 || target.depthFormat() == GL_DEPTH32F_STENCIL8;
  glFramebufferTexture2D(GL_FRAMEBUFFER,
                         stencil ? GL_DEPTH_STENCIL_ATTACHMENT : GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D,
                         target.depth(), 0);
  if (target.second()) {
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT1, GL_TEXTURE_2D, target.second(), 0);
    constexpr std::array<GLenum, 2> both{GL_COLOR_ATTACHMENT0, GL_COLOR_ATTACHMENT1};
    glDrawBuffers(GLsizei(both.size()), both.data());
  }
  if (glCheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
    glDeleteFramebuffers(1, &framebuffer_);
    throw Error("the graphics driver can't blend into a floating-point picture of " +
                std::to_string(target.width()) + "x" + std::to_string(target.height()) + " pixels");
  }
  glGenVertexArrays(1, &vertex_array_);
  glBindVertexArray(vertex_array_);
}

DrawScope::~DrawScope() {
  glDeleteVertexArrays(1, &vertex_array_);
  glDeleteFramebuffers(1, &framebuffer_);
}

SampledDepth::SampledDepth(int width, int height, int samples)
    : width_(width), height_(height), samples_(samples) {
  bytes_ = 4 * static_cast<std::size_t>(width) * static_cast<std::size_t>(height) *
           static_cast<std::size_t>(samples);
  GLint bound = 0;
  glGetIntegerv(GL_TEXTURE_BINDING_2D_MULTISAMPLE, &bound);
  GLuint id = 0;
  glGenTextures(1, &id);
  glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, id);
  texture_ = Object(GL_TEXTURE, id);
  // Not of immutable storage: Mesa 22.3 attaches such a texture to a framebuffer only once.
  glTexImage2DMultisample(GL_TEXTURE_2D_MULTISAMPLE, samples, GL_DEPTH_COMPONENT24, width, height,
                          GL_TRUE);
  glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, static_cast<GLuint>(bound));
}

DepthScope::DepthScope(const SampledDepth& depth) {
  glGetIntegerv(GL_DRAW_FRAMEBUFFER_BINDING, &draw_framebuffer_);
  glGetIntegerv(GL_READ_FRAMEBUFFER_BINDING, &read_framebuffer_);
  glGetIntegerv(GL_VIEWPORT, viewport_.data());
  glGenFramebuffers(1, &framebuffer_);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D_MULTISAMPLE,
                         depth.texture(), 0);
  glDrawBuffer(GL_NONE);
  glReadBuffer(GL_NONE);
  glViewport(0, 0, depth.width(), depth.height());
  glPushAttrib(GL_DEPTH_BUFFER_BIT | GL_SCISSOR_BIT);
  glDisable(GL_SCISSOR_TEST);
  glDepthMask(GL_TRUE);
  const GLfloat farthest = 1.0f;
  glClearBufferfv(GL_DEPTH, 0, &farthest);
  glPopAttrib();
}

DepthScope::~DepthScope() {
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, static_cast<GLuint>(draw_framebuffer_));
  glBindFramebuffer(GL_READ_FRAMEBUFFER, static_cast<GLuint>(read_framebuffer_));
  glDeleteFramebuffers(1, &framebuffer_);
  glViewport(viewport_[0], viewport_[1], viewport_[2], viewport_[3]);
}

PixelScope::PixelScope() {
  glGetIntegerv(GL_PIXEL_PACK_BUFFER_BINDING, &pack_buffer_);
  glGetIntegerv(GL_PIXEL_UNPACK_BUFFER_BINDING, &unpack_buffer_);
  glPushClientAttrib(GL_CLIENT_PIXEL_STORE_BIT);
  glBindBuffer(GL_PIXEL_PACK_BUFFER, 0);
  glBindBuffer(GL_PIXEL_UNPACK_BUFFER, 0);
  for (const GLenum none :
       {GL_PACK_ROW_LENGTH, GL_PACK_SKIP_ROWS, GL_PACK_SKIP_PIXELS, GL_PACK_SWAP_BYTES,
        GL_PACK_LSB_FIRST, GL_UNPACK_ROW_LENGTH, GL_UNPACK_SKIP_ROWS, GL_UNPACK_SKIP_PIXELS,
        GL_UNPACK_SWAP_BYTES, GL_UNPACK_LSB_FIRST}) {
    glPixelStorei(none, 0);
  }
}

PixelScope::~PixelScope() {
  glPopClientAttrib();
  glBindBuffer(GL_PIXEL_PACK_BUFFER, static_cast<GLuint>(pack_buffer_));
  glBindBuffer(GL_PIXEL_UNPACK_BUFFER, static_cast<GLuint>(unpack_buffer_));
}

DepthFramebuffer::DepthFramebuffer(GLenum format, int width, int height) {
  GLint bound = 0;
  glGetIntegerv(GL_RENDERBUFFER_BINDING, &bound);
  glGenRenderbuffers(1, &depths_);
  glBindRenderbuffer(GL_RENDERBUFFER, depths_);
  glRenderbufferStorage(GL_RENDERBUFFER, format, width, height);
  glBindRenderbuffer(GL_RENDERBUFFER, static_cast<GLuint>(bound));
  glGenFramebuffers(1, &id_);
  glBindFramebuffer(GL_FRAMEBUFFER, id_);
  const bool stencil = format == GL_DEPTH24_STENCIL8 || format == GL_DEPTH32F_STENCIL8;
  glFramebufferRenderbuffer(GL_FRAMEBUFFER,
                            stencil ? GL_DEPTH_STENCIL_ATTACHMENT : GL_DEPTH_ATTACHMENT,
                            GL_RENDERBUFFER, depths_);
  glDrawBuffer(GL_NONE);
  glReadBuffer(GL_NONE);
}

DepthFramebuffer::~DepthFramebuffer() {
  glDeleteFramebuffers(1, &id_);
  glDeleteRenderbuffers(1, &depths_);
}

std::vector<float> readDepths(int x, int y, int width, int height, bool top_first) {
  const auto columns = static_cast<std::size_t>(width), rows = static_cast<std::size_t>(height);
  std::vector<float> depths(columns * rows);
  const PixelScope scope;
  glReadPixels(x, y, width, height, GL_DEPTH_COMPONENT, GL_FLOAT, depths.data());
  for (std::size_t row = 0; !top_first && row < rows / 2; ++row) {
    float* const upper = &depths[columns * row];
    std::swap_ranges(upper, upper + columns, &depths[columns * (rows - 1 - row)]);
  }
  return depths;
}

std::vector<float> readPixels(int width, int height) {
  std::vector<float> pixels(4 * static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  const PixelScope scope;
  glReadPixels(0, 0, width, height, GL_RGBA, GL_FLOAT, pixels.data());
  return pixels;
}

ComputeScope::~ComputeScope() {
  glUseProgram(static_cast<GLuint>(program_));
  if (epoxy_gl_version() < 44) return;  // then nothing has bound the rest either
  glBindBuffersBase(GL_SHADER_STORAGE_BUFFER, 0, kStorageBindings, nullptr);
  for (const GLuint block : {0, 1}) glBindBufferBase(GL_UNIFORM_BUFFER, block, 0);
  glBindImageTextures(0, kImageUnits, nullptr);
  for (const GLenum target : {GL_COPY_READ_BUFFER, GL_COPY_WRITE_BUFFER}) glBindBuffer(target, 0);
}

StateGuard::StateGuard()
    : framebuffers_(hasFramebuffers()),
      vertex_arrays_(epoxy_gl_version() >= 30 ||
                     epoxy_has_gl_extension("GL_ARB_vertex_array_object")),
      sampled_textures_(epoxy_gl_version() >= 32) {
  if (framebuffers_) {
    GLint draw = 0, read = 0;
    glGetIntegerv(GL_DRAW_FRAMEBUFFER_BINDING, &draw);
    glGetIntegerv(GL_READ_FRAMEBUFFER_BINDING, &read);
    draw_framebuffer_ = static_cast<GLuint>(draw);
    read_framebuffer_ = static_cast<GLuint>(read);
  }
  if (vertex_arrays_) glGetIntegerv(GL_VERTEX_ARRAY_BINDING, &vertex_array_);
  glGetIntegerv(GL_ARRAY_BUFFER_BINDING, &array_buffer_);
  glGetIntegerv(GL_ACTIVE_TEXTURE, &active_texture_);
  glActiveTexture(GL_TEXTURE0);
  glGetIntegerv(GL_TEXTURE_BINDING_2D, &texture_);
  if (sampled_textures_) glGetIntegerv(GL_TEXTURE_BINDING_2D_MULTISAMPLE, &sampled_texture_);
  // rviz's context is a compatibility profile: the attribute stack holds the rest.
  glPushAttrib(GL_ALL_ATTRIB_BITS);
}

StateGuard::~StateGuard() {
  // Framebuffers first: the attributes hold the draw and read buffers of the one that was bound.
  if (framebuffers_) {
    glBindFramebuffer(GL_DRAW_FRAMEBUFFER, draw_framebuffer_);
    glBindFramebuffer(GL_READ_FRAMEBUFFER, read_framebuffer_);
  }
  glPopAttrib();
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, static_cast<GLuint>(texture_));
  if (sampled_textures_) {
    glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, static_cast<GLuint>(sampled_texture_));
  }
  glActiveTexture(static_cast<GLenum>(active_texture_));
  if (vertex_arrays_) glBindVertexArray(static_cast<GLuint>(vertex_array_));
  glBindBuffer(GL_ARRAY_BUFFER, static_cast<GLuint>(array_buffer_));
}

Stopwatch::~Stopwatch() {
  for (const auto& [name, query] : queries_) glDeleteQueries(1, &query);
}

void Stopwatch::lap(const char* name) {
  if (!running_) return;
  GLuint query = 0;
  glGenQueries(1, &query);
  glQueryCounter(query, GL_TIMESTAMP);
  queries_.emplace_back(name, query);
}

std::map<std::string, double> Stopwatch::laps() const {
  std::map<std::string, double> laps;
  GLuint64 last = 0;
  for (const auto& [name, query] : queries_) {
    GLuint64 time = 0;
    glGetQueryObjectui64v(query, GL_QUERY_RESULT, &time);
    if (*name) laps[name] += 1e-9 * static_cast<double>(time - last);
    last = time;
  }
  return laps;
}

bool accelerated() {
  const auto* name = reinterpret_cast<const char*>(glGetString(GL_RENDERER));
  const std::string_view renderer = name ? name : "";
  for (const char* software : {"llvmpipe", "softpipe", "swrast", "SWR", "Software"}) {
    if (renderer.find(software) != std::string_view::npos) return false;
  }
  return true;
}

std::string unsupported() {
  const int version = epoxy_gl_version();
  const auto* renderer = reinterpret_cast<const char*>(glGetString(GL_RENDERER));
  const std::string driver = std::string(" (driver: ") + (renderer ? renderer : "unknown") + ")";
  if (!epoxy_is_desktop_gl() || version < 44) {
    return "OpenGL 4.4 is needed to draw splats, this is " + std::to_string(version / 10) + "." +
           std::to_string(version % 10) + driver + "; update the graphics driver";
  }
  GLint compute_buffers = 0;
  glGetIntegerv(GL_MAX_COMPUTE_SHADER_STORAGE_BLOCKS, &compute_buffers);
  if (compute_buffers < kStorageBindings) {
    return "the graphics driver gives a compute shader " + std::to_string(compute_buffers) +
           " storage buffers, " + std::to_string(kStorageBindings) + " are needed" + driver;
  }
  return {};
}

}  // namespace rosplat::gl
