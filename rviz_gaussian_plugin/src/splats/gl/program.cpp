#include "gl/program.hpp"

#include <algorithm>

#include "gl/driver.hpp"
#include "gl/object.hpp"

namespace rosplat::gl {

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

}  // namespace rosplat::gl
