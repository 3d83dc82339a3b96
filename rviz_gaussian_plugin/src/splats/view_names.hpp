#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "rosplat_core/order/picture.hpp"

namespace rosplat {

// Names of views. Each display has an id of its own for its view; displays that show a view
// together share its name.
class ViewNames {
 public:
  // Called with a name that no display's view has any more.
  using Unused = std::function<void(const std::string& name)>;

  // Gives these views one name, that of the first with a name or else the first id. Returns it.
  const std::string& join(const std::vector<std::string>& view_ids, const Unused& unused);
  // The same for the views of a picture's layers.
  template <typename Map>
  const std::string& join(const Picture<Map>& picture, const Unused& unused) {
    std::vector<std::string> view_ids;
    for (const Layer<Map>& layer : picture.layers) view_ids.push_back(layer.view_id);
    return join(view_ids, unused);
  }
  void forget(const std::string& view_id, const Unused& unused);
  // The name of a display's view; null if it was never joined or is forgotten.
  const std::string* of(const std::string& view_id) const;

 private:
  bool inUse(const std::string& name) const;

  std::map<std::string, std::string> names_;  // by a display's view
};

}  // namespace rosplat
