#include "gl/object.hpp"

#include <algorithm>
#include <array>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

namespace rosplat::gl {

namespace {

struct Abandoned {
  GLenum kind;
  GLuint id;
  std::uint64_t number;
};

std::mutex mutex;
std::uint64_t objects = 0;
// Never destroyed, because an Object may be destroyed even later.
std::vector<Abandoned>& abandoned = *new std::vector<Abandoned>;

std::string labelOf(std::uint64_t number) { return "rosplat " + std::to_string(number); }

void destroy(GLenum kind, GLuint id) {
  if (kind == GL_BUFFER) {
    glDeleteBuffers(1, &id);
  } else {
    glDeleteTextures(1, &id);
  }
}

bool exists(GLenum kind, GLuint id) { return kind == GL_BUFFER ? glIsBuffer(id) : glIsTexture(id); }

bool belongsHere(const Abandoned& object) {
  if (!hasLabels() || !exists(object.kind, object.id)) return false;
  std::array<char, 64> label{};
  glGetObjectLabel(object.kind, object.id, static_cast<GLsizei>(label.size()), nullptr,
                   label.data());
  return label.data() == labelOf(object.number);
}

}  // namespace

bool hasLabels() { return epoxy_gl_version() >= 43 || epoxy_has_gl_extension("GL_KHR_debug"); }

Object::Object(GLenum kind, GLuint id) : kind_(kind), id_(id) {
  {
    const std::lock_guard lock(mutex);
    number_ = ++objects;
  }
  if (hasLabels()) glObjectLabel(kind, id, -1, labelOf(number_).c_str());
}

Object& Object::operator=(Object&& other) noexcept {
  std::swap(kind_, other.kind_);
  std::swap(id_, other.id_);
  std::swap(number_, other.number_);
  return *this;
}

Object::~Object() {
  if (!id_) return;
  const std::lock_guard lock(mutex);
  abandoned.push_back({kind_, id_, number_});
}

void Object::release() {
  if (id_) destroy(kind_, id_);
  id_ = 0;
}

void deleteAbandoned() {
  const std::lock_guard lock(mutex);
  const auto others =
      std::stable_partition(abandoned.begin(), abandoned.end(),
                            [](const Abandoned& object) { return !belongsHere(object); });
  for (auto object = others; object != abandoned.end(); ++object) destroy(object->kind, object->id);
  abandoned.erase(others, abandoned.end());
}

}  // namespace rosplat::gl
