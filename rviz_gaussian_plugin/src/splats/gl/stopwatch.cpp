#include "gl/stopwatch.hpp"

namespace rosplat::gl {

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

}  // namespace rosplat::gl
