#pragma once

#include <epoxy/gl.h>

#include <map>
#include <string>
#include <utility>
#include <vector>

namespace rosplat::gl {

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

}  // namespace rosplat::gl
