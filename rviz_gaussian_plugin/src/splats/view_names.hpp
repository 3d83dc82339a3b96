#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

namespace rosplat {

// What displays call the views that they show, each for itself: those that show one together have
// one name for it.
class ViewNames {
 public:
  // Is told of a name that no display has any more.
  using Unused = std::function<void(const std::string& name)>;

  // The one that these views are, by name; they have another one together if they were apart.
  const std::string& join(const std::vector<std::string>& view_ids, const Unused& unused);
  void forget(const std::string& view_id, const Unused& unused);
  // Null where it is none, or forgotten.
  const std::string* of(const std::string& view_id) const;

 private:
  bool inUse(const std::string& name) const;

  std::map<std::string, std::string> names_;  // by a display's view
};

}  // namespace rosplat
