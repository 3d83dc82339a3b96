#pragma once

#include <QObject>
#include <QString>
#include <functional>

class QMimeData;
class QWidget;

namespace rosplat {

// The first scene that a drag carries: a local scene file, or a folder with the meta.json of a SOG.
// Empty if there is none.
QString sceneIn(const QMimeData& data);

// Takes scene files that are dropped on a window, or on a panel of it that embeds another window.
class SceneDrop : public QObject {
  Q_OBJECT

 public:
  // Called with a path; returns whether it is taken.
  using DropCallback = std::function<bool(const QString& path)>;

  SceneDrop(QWidget* window, QWidget* panel, DropCallback on_drop);

  bool eventFilter(QObject* watched, QEvent* event) override;

 private:
  DropCallback on_drop_;
};

}  // namespace rosplat
