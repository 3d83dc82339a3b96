// rviz2 with a remote control and a stopwatch, for tests and benchmarks: one JSON object a line
// comes in on the local socket $ROSPLAT_RVIZ_SOCKET, one goes out. driven_rviz.py speaks it.

#include <OgreFrameListener.h>
#include <OgreRenderSystem.h>
#include <OgreRenderTarget.h>
#include <OgreRoot.h>
#include <OgreViewport.h>
#include <epoxy/gl.h>
#include <malloc.h>

#include <QAbstractItemModel>
#include <QApplication>
#include <QComboBox>
#include <QDialog>
#include <QDialogButtonBox>
#include <QDockWidget>
#include <QDragEnterEvent>
#include <QFile>
#include <QImage>
#include <QJsonArray>
#include <QJsonDocument>
#include <QJsonObject>
#include <QLabel>
#include <QLocalServer>
#include <QLocalSocket>
#include <QMimeData>
#include <QPushButton>
#include <QStatusBar>
#include <QStyleOptionViewItem>
#include <QTabWidget>
#include <QTreeWidget>
#include <QUrl>
#include <QWindow>
#include <chrono>
#include <cmath>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <rclcpp/logging.hpp>
#include <rclcpp/utilities.hpp>
#include <rviz_common/display.hpp>
#include <rviz_common/display_group.hpp>
#include <rviz_common/interaction/selection_manager_iface.hpp>
#include <rviz_common/logging.hpp>
#include <rviz_common/properties/property.hpp>
#include <rviz_common/properties/property_tree_model.hpp>
#include <rviz_common/properties/status_property.hpp>
#include <rviz_common/render_panel.hpp>
#include <rviz_common/ros_integration/ros_client_abstraction.hpp>
#include <rviz_common/view_controller.hpp>
#include <rviz_common/view_manager.hpp>
#include <rviz_common/visualization_frame.hpp>
#include <rviz_common/visualization_manager.hpp>
#include <rviz_common/visualizer_app.hpp>
#include <rviz_rendering/render_window.hpp>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace {

using rviz_common::Display;
using rviz_common::VisualizationFrame;
using rviz_common::properties::Property;
using rviz_common::properties::StatusProperty;

struct Refusal : std::runtime_error {
  using std::runtime_error::runtime_error;
};

VisualizationFrame& frame() {
  for (QWidget* widget : QApplication::topLevelWidgets()) {
    if (auto* found = qobject_cast<VisualizationFrame*>(widget)) return *found;
  }
  throw Refusal("there is no window of rviz");
}

rviz_common::VisualizationManager& manager() { return *frame().getManager(); }

Property& root(const QString& name) {
  if (name == "view") return *manager().getViewManager()->getCurrent();
  if (name == "selection") return *manager().getSelectionManager()->getPropertyModel()->getRoot();
  return *manager().getRootDisplayGroup();
}

Property& at(const QJsonObject& request) {
  Property* property = &root(request["root"].toString());
  for (const auto& name : request["path"].toArray()) {
    Property* child = nullptr;
    for (int i = 0; i < property->numChildren(); ++i) {
      if (property->childAt(i)->getName() == name.toString()) child = property->childAt(i);
    }
    if (!child) throw Refusal("no property " + name.toString().toStdString());
    property = child;
  }
  return *property;
}

Display& display(const QJsonObject& request) {
  auto* found = qobject_cast<Display*>(&at(request));
  if (!found) throw Refusal("that is no display");
  return *found;
}

QJsonObject describe(const Property& property) {
  QJsonArray children;
  for (int i = 0; i < property.numChildren(); ++i) children.append(describe(*property.childAt(i)));
  QJsonObject object{{"name", property.getName()},
                     {"value", QJsonValue::fromVariant(property.getValue())},
                     {"hidden", property.getHidden()},
                     {"children", children}};
  if (const auto* status = qobject_cast<const StatusProperty*>(&property)) {
    object["level"] = StatusProperty::statusWord(status->getLevel());
  }
  return object;
}

// What a property's combo box offers.
QJsonArray options(Property& property) {
  const std::unique_ptr<QWidget> editor(property.createEditor(nullptr, QStyleOptionViewItem()));
  const auto* box = qobject_cast<QComboBox*>(editor.get());
  if (!box) throw Refusal("that property has no choices");
  QJsonArray texts;
  for (int i = 0; i < box->count(); ++i) texts.append(box->itemText(i));
  return texts;
}

// Where things are on the screen: docked widgets by their title, rviz's own view as "view".
QJsonObject places() {
  QJsonObject found;
  const auto add = [&found](const QString& name, const QWidget& widget) {
    const QPoint corner = widget.mapToGlobal(QPoint(0, 0));
    found[name] = QJsonArray{corner.x(), corner.y(), widget.width(), widget.height()};
  };
  add("view", *manager().getRenderPanel());
  for (const auto* dock : frame().findChildren<QDockWidget*>()) {
    const auto* panel = dock->findChild<rviz_common::RenderPanel*>();
    add(dock->windowTitle(), panel ? *static_cast<const QWidget*>(panel) : *dock);
  }
  return found;
}

// Memory that is allocated and not freed, whether it is resident or not. [bytes]
double allocated() {
  const struct mallinfo2 heaps = mallinfo2();
  return static_cast<double>(heaps.uordblks + heaps.hblkhd);
}

// How many names are in use, by kind of OpenGL object.
QJsonObject glObjects() {
  constexpr GLuint kNames = 1u << 16;
  if (!epoxy_has_gl_extension("GL_ARB_vertex_buffer_object") && epoxy_gl_version() < 15) {
    throw Refusal("no OpenGL context is current");
  }
  const std::map<QString, std::function<GLboolean(GLuint)>> kinds{
      {"buffers", [](GLuint name) { return glIsBuffer(name); }},
      {"textures", [](GLuint name) { return glIsTexture(name); }},
      {"renderbuffers", [](GLuint name) { return glIsRenderbuffer(name); }},
      {"programs", [](GLuint name) { return glIsProgram(name); }},
      {"shaders", [](GLuint name) { return glIsShader(name); }},
      {"framebuffers", [](GLuint name) { return glIsFramebuffer(name); }},
      {"vertex arrays", [](GLuint name) { return glIsVertexArray(name); }}};
  QJsonObject counts;
  for (const auto& [kind, exists] : kinds) {
    int count = 0;
    for (GLuint name = 1; name < kNames; ++name) count += exists(name) ? 1 : 0;
    counts[kind] = count;
  }
  return counts;
}

// Drops a file in the middle of the render panel, as the window system hands it to the window;
// returns whether the drop was accepted.
bool drop(const QString& file) {
  QMimeData data;
  data.setUrls({QUrl::fromLocalFile(file)});
  QWindow* window = frame().windowHandle();
  const QWidget& panel = *manager().getRenderPanel();
  const QPoint point = panel.mapTo(&frame(), panel.rect().center());
  QDragEnterEvent enter(point, Qt::CopyAction, &data, Qt::LeftButton, Qt::NoModifier);
  QApplication::sendEvent(window, &enter);
  QDragMoveEvent move(point, Qt::CopyAction, &data, Qt::LeftButton, Qt::NoModifier);
  QApplication::sendEvent(window, &move);
  if (!move.isAccepted()) {
    QDragLeaveEvent leave;
    QApplication::sendEvent(window, &leave);
    return false;
  }
  QDropEvent drop(point, Qt::CopyAction, &data, Qt::LeftButton, Qt::NoModifier);
  QApplication::sendEvent(window, &drop);
  return drop.isAccepted();
}

// The dialog that has been opened, null until it is.
QDialog* dialog() { return qobject_cast<QDialog*>(QApplication::activeModalWidget()); }

QJsonArray texts(const QTreeWidgetItem& item) {
  QJsonArray children;
  for (int i = 0; i < item.childCount(); ++i) children.append(texts(*item.child(i)));
  return {item.text(0), children};
}

// rviz's dialog to add displays, "By topic".
QTreeWidget& topicTree() {
  if (!dialog()) throw Refusal("no dialog is open");
  auto* tabs = dialog()->findChild<QTabWidget*>();
  tabs->setCurrentIndex(1);
  return *tabs->currentWidget()->findChild<QTreeWidget*>();
}

// Resizes the render panel, which may take effect later; returns its size before.
QJsonArray resize(const QSize& size) {
  for (auto* dock : frame().findChildren<QDockWidget*>()) dock->hide();
  const QSize panel = manager().getRenderPanel()->size();
  frame().resize(frame().size() + size - panel);
  return {panel.width(), panel.height()};
}

// Times the frames of rviz's window. While the watch runs, rviz draws as often as it can.
class Stopwatch : public QObject, public Ogre::FrameListener {
 public:
  Stopwatch() {
    Ogre::Root::getSingleton().addFrameListener(this);
    connect(&manager(), &rviz_common::VisualizationManager::preUpdate, this, [this] { hurry(); });
  }
  ~Stopwatch() override { Ogre::Root::getSingleton().removeFrameListener(this); }

  // turn: how fast the Orbit view turns [rad/s]
  void start(double turn) {
    turn_ = turn;
    first_yaw_ = yaw().getValue().toDouble();
    swaps_.clear();
    drawing_ = {};
    running_ = true;
    began_ = Clock::now();
  }

  int frames() const { return static_cast<int>(swaps_.size()); }

  // frame: times between two swaps of the window's buffers. drawing: times between a frame's begin
  // and its swap, by the GPU's clock. [ms]
  QJsonObject stop() {
    running_ = false;
    makeCurrent();
    while (!pending_.empty()) collect();
    QJsonArray frames;
    for (std::size_t i = 1; i < swaps_.size(); ++i) {
      frames.append(std::chrono::duration<double, std::milli>(swaps_[i] - swaps_[i - 1]).count());
    }
    return {{"frame", frames},
            {"drawing", drawing_},
            {"renderer", reinterpret_cast<const char*>(glGetString(GL_RENDERER))}};
  }

  // Writes the next frame as it will be shown. The file appears only when it is complete.
  void photograph(const QString& file) {
    picture_ = file;
    manager().queueRender();
  }

 private:
  using Clock = std::chrono::steady_clock;
  struct Span {
    GLuint begin;
    GLuint end;
  };

  static Property& yaw() { return *manager().getViewManager()->getCurrent()->subProp("Yaw"); }

  static Ogre::RenderTarget& window() {
    auto* panel = manager().getRenderPanel()->getRenderWindow();
    return *rviz_rendering::RenderWindowOgreAdapter::getOgreViewport(panel)->getTarget();
  }

  // Queries belong to an OpenGL context, and each window has its own.
  static void makeCurrent() {
    Ogre::Root::getSingleton().getRenderSystem()->_setRenderTarget(&window());
  }

  void hurry() {
    if (!running_) return;
    manager().queueRender();
    if (turn_ != 0) {
      const std::chrono::duration<double> passed = Clock::now() - began_;
      yaw().setValue(std::fmod(first_yaw_ + turn_ * passed.count(), 2 * M_PI));
    }
  }

  bool frameStarted(const Ogre::FrameEvent& /*event*/) override {
    drawn_ = running_;
    if (!drawn_) return true;
    makeCurrent();
    pending_.push_back({});
    glGenQueries(1, &pending_.back().begin);
    glGenQueries(1, &pending_.back().end);
    glQueryCounter(pending_.back().begin, GL_TIMESTAMP);
    return true;
  }

  bool frameRenderingQueued(const Ogre::FrameEvent& /*event*/) override {
    if (drawn_) {
      makeCurrent();
      glQueryCounter(pending_.back().end, GL_TIMESTAMP);
      while (pending_.size() > 1 && isFinished(pending_.front())) collect();
    }
    if (!picture_.isEmpty()) write(std::exchange(picture_, {}));
    return true;
  }

  bool frameEnded(const Ogre::FrameEvent& /*event*/) override {
    if (drawn_) swaps_.push_back(Clock::now());
    return true;
  }

  static bool isFinished(const Span& span) {
    GLint available = 0;
    glGetQueryObjectiv(span.end, GL_QUERY_RESULT_AVAILABLE, &available);
    return available;
  }

  void collect() {
    const Span& span = pending_.front();
    GLuint64 begin = 0;
    GLuint64 end = 0;
    glGetQueryObjectui64v(span.begin, GL_QUERY_RESULT, &begin);
    glGetQueryObjectui64v(span.end, GL_QUERY_RESULT, &end);
    drawing_.append(static_cast<double>(end - begin) * 1e-6);
    glDeleteQueries(1, &span.begin);
    glDeleteQueries(1, &span.end);
    pending_.pop_front();
  }

  static void write(const QString& file) {
    Ogre::RenderTarget& target = window();
    const Ogre::Box all(0, 0, target.getWidth(), target.getHeight());
    QImage image(static_cast<int>(all.right), static_cast<int>(all.bottom),
                 QImage::Format_RGBX8888);
    target.copyContentsToMemory(all, Ogre::PixelBox(all, Ogre::PF_BYTE_RGBA, image.bits()),
                                Ogre::RenderTarget::FB_BACK);
    const QString part = file + ".part";
    if (image.save(part, "PNG")) QFile::rename(part, file);
  }

  bool running_ = false;
  bool drawn_ = false;  // whether the watch ran when this frame began
  double turn_ = 0;
  double first_yaw_ = 0;
  Clock::time_point began_;
  std::vector<Clock::time_point> swaps_;
  QJsonArray drawing_;
  std::deque<Span> pending_;
  QString picture_;
};

QJsonValue answer(const QJsonObject& request, Stopwatch& watch) {
  const QString what = request["do"].toString();
  if (what == "tree") return describe(at(request));
  if (what == "options") return options(at(request));
  if (what == "places") return places();
  if (what == "status line") return frame().statusBar()->findChild<QLabel*>()->text();
  if (what == "gl") return glObjects();
  if (what == "allocated") return allocated();
  if (what == "drop") return drop(request["file"].toString());
  if (what == "resize") return resize({request["width"].toInt(), request["height"].toInt()});
  if (what == "frames") return watch.frames();
  if (what == "stop watch") return watch.stop();
  if (what == "set") {
    if (!at(request).setValue(request["value"].toVariant())) throw Refusal("not changed");
  } else if (what == "load") {
    frame().setWindowModified(false);  // or rviz asks whether to save
    frame().loadDisplayConfig(request["file"].toString());
  } else if (what == "save") {
    if (!frame().saveDisplayConfig(request["file"].toString())) throw Refusal("not saved");
  } else if (what == "add") {
    manager().createDisplay(request["class"].toString(), request["name"].toString(), true);
  } else if (what == "remove") {
    delete &display(request);
  } else if (what == "reset") {
    display(request).reset();
  } else if (what == "open add dialog") {
    for (auto* button : frame().findChildren<QPushButton*>()) {
      if (button->text() == "Add") QMetaObject::invokeMethod(button, "click", Qt::QueuedConnection);
    }
  } else if (what == "topics") {
    return texts(*topicTree().invisibleRootItem());
  } else if (what == "add topic") {
    // The tree nests topics by the words of their names; the path's last item is a display.
    QTreeWidgetItem* item = topicTree().invisibleRootItem();
    for (const auto& text : request["path"].toArray()) {
      QTreeWidgetItem* child = nullptr;
      for (int i = 0; i < item->childCount(); ++i) {
        if (item->child(i)->text(0) == text.toString()) child = item->child(i);
      }
      if (!child) throw Refusal("no item " + text.toString().toStdString());
      item = child;
    }
    topicTree().setCurrentItem(item);
    dialog()->findChild<QDialogButtonBox*>()->button(QDialogButtonBox::Ok)->click();
  } else if (what == "start watch") {
    watch.start(request["turn"].toDouble());
  } else if (what == "photograph") {
    watch.photograph(request["file"].toString());
  } else if (what == "quit") {
    frame().setWindowModified(false);
    QMetaObject::invokeMethod(&frame(), "close", Qt::QueuedConnection);
  } else {
    throw Refusal("unknown: " + what.toStdString());
  }
  return true;
}

void serve(QLocalSocket& socket, Stopwatch& watch) {
  while (socket.canReadLine()) {
    const QJsonObject request = QJsonDocument::fromJson(socket.readLine()).object();
    QJsonObject reply;
    try {
      reply["result"] = answer(request, watch);
    } catch (const std::exception& error) {
      reply["error"] = error.what();
    }
    socket.write(QJsonDocument(reply).toJson(QJsonDocument::Compact) + '\n');
    socket.flush();
  }
}

}  // namespace

// As rviz2's own main().
int main(int argc, char** argv) {
  std::vector<std::string> words = rclcpp::remove_ros_arguments(argc, argv);
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  int count = static_cast<int>(arguments.size());
  QApplication application(count, arguments.data());
  const auto logger = rclcpp::get_logger("rviz2");
  rviz_common::set_logging_handlers(
      [logger](const std::string& text, const std::string&, std::size_t) {
        RCLCPP_DEBUG(logger, "%s", text.c_str());
      },
      [logger](const std::string& text, const std::string&, std::size_t) {
        RCLCPP_INFO(logger, "%s", text.c_str());
      },
      [logger](const std::string& text, const std::string&, std::size_t) {
        RCLCPP_WARN(logger, "%s", text.c_str());
      },
      [logger](const std::string& text, const std::string&, std::size_t) {
        RCLCPP_ERROR(logger, "%s", text.c_str());
      });
  rviz_common::VisualizerApp rviz(
      std::make_unique<rviz_common::ros_integration::RosClientAbstraction>());
  rviz.setApp(&application);
  if (!rviz.init(argc, argv)) return 1;
  Stopwatch watch;
  QLocalServer server;
  QObject::connect(&server, &QLocalServer::newConnection, [&server, &watch] {
    QLocalSocket* socket = server.nextPendingConnection();
    QObject::connect(socket, &QLocalSocket::readyRead, [socket, &watch] { serve(*socket, watch); });
  });
  if (!server.listen(qEnvironmentVariable("ROSPLAT_RVIZ_SOCKET"))) return 1;
  return application.exec();
}
