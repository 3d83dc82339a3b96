#include "scene_drop.hpp"

#include <QDir>
#include <QDropEvent>
#include <QFileInfo>
#include <QMimeData>
#include <QStringList>
#include <QUrl>
#include <QWidget>
#include <utility>

namespace rosplat {

QString sceneIn(const QMimeData& data) {
  for (const QUrl& url : data.urls()) {
    const QFileInfo file(url.toLocalFile());
    const QStringList suffixes = {"ply", "spz",  "sog", "splat", "ksplat", "npz",
                                  "glb", "gltf", "usd", "usda",  "usdc",   "usdz"};
    const QStringList metas = {"meta.json", "lod-meta.json"};
    const bool folder = file.isDir() && (QDir(file.filePath()).exists(metas[0]) ||
                                         QDir(file.filePath()).exists(metas[1]));
    const bool scene =
        folder || suffixes.contains(file.suffix().toLower()) || metas.contains(file.fileName());
    if (scene) return file.filePath();
  }
  return {};
}

SceneDrop::SceneDrop(QWidget* window, QWidget* panel, DropCallback on_drop)
    : on_drop_(std::move(on_drop)) {
  window->setAcceptDrops(true);
  window->installEventFilter(this);
  // The widget that holds an embedded window gets the drags over it, and passes them to the window.
  for (QWidget* holder : panel->findChildren<QWidget*>()) holder->installEventFilter(this);
}

bool SceneDrop::eventFilter(QObject*, QEvent* event) {
  const bool drop = event->type() == QEvent::Drop;
  if (!drop && event->type() != QEvent::DragEnter && event->type() != QEvent::DragMove) {
    return false;
  }
  auto* drag = static_cast<QDropEvent*>(event);  // base of the other drag events
  const QString path = sceneIn(*drag->mimeData());
  if (path.isEmpty() || (drop && !on_drop_(path))) return false;
  drag->acceptProposedAction();
  return true;
}

}  // namespace rosplat
