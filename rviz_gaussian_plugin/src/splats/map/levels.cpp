#include "map/levels.hpp"

#include <algorithm>
#include <atomic>
#include <iterator>
#include <limits>
#include <new>
#include <utility>

namespace rosplat {

namespace {

constexpr std::uint32_t kSlots = SlotPage::kSlots;

// Goes through the nodes of a level as they ascend, from a cell on.
class NodeCursor {
 public:
  NodeCursor(const Levels::Pages& pages, Cell from) : end_(pages.end()) {
    page_ = std::upper_bound(pages.begin(), pages.end(), from, [](Cell cell, const auto& page) {
      return cell < page->cells.front();
    });
    if (page_ != pages.begin()) --page_;
    skipTo(from);
  }

  // To the first node from a cell on that isn't before this one.
  void skipTo(Cell from) {
    for (; page_ != end_ && (*page_)->cells.back() < from; ++page_) i_ = 0;
    if (page_ == end_) return;
    const std::vector<Cell>& cells = (*page_)->cells;
    i_ = std::size_t(std::lower_bound(cells.begin() + std::ptrdiff_t(i_), cells.end(), from) -
                     cells.begin());
  }
  bool before(Cell cell) const { return page_ != end_ && (*page_)->cells[i_] < cell; }
  Node node(int sh_degree) const { return (*page_)->node(i_, sh_degree); }
  PackedSlot packed(int sh_degree) const { return (*page_)->slots.packed(i_, sh_degree); }
  void next() {
    if (++i_ < (*page_)->cells.size()) return;
    ++page_;
    i_ = 0;
  }

 private:
  Levels::Pages::const_iterator page_, end_;
  std::size_t i_ = 0;
};

// Where slots lie that come in ascending order, mostly.
class SlotFinder {
 public:
  explicit SlotFinder(const HostSlots& slots) : slots_(slots) {}

  const HostSlots::Page& pageOf(std::uint32_t slot) {
    if (!page_ || slot - page_->first_slot >= kSlots) page_ = slots_.index().find(slot);
    return slots_.at(*page_);
  }

 private:
  const HostSlots& slots_;
  const SlotPage* page_ = nullptr;
};

template <typename Changes>
auto changesFrom(const Changes& changes, Cell from) {
  return std::lower_bound(changes.begin(), changes.end(), from,
                          [](const auto& change, Cell cell) { return change.cell < cell; });
}

}  // namespace

NodePage::NodePage(const Node* nodes, std::size_t count, int sh_degree, std::uint32_t group) {
  constexpr float infinity = std::numeric_limits<float>::infinity();
  bounds.first_slot = kNoSlot;
  bounds.group = group;
  bounds.least.fill(infinity);
  bounds.most.fill(-infinity);
  slots.extent.fill(-1);
  for (std::size_t i = 0; i < count; ++i) {
    const Node& node = nodes[i];
    slots.put(i, node.packed, sh_degree);
    slots.extent[i] = node.extent;
    bounds.extent = std::max(bounds.extent, node.extent);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const float x = slots.position[axis][i];
      bounds.least[axis] = std::min(bounds.least[axis], x);
      bounds.most[axis] = std::max(bounds.most[axis], x);
    }
    cells.push_back(node.cell);
    members_.insert(members_.end(), node.members.begin(), node.members.end());
    ends_.push_back(static_cast<std::uint32_t>(members_.size()));
  }
}

Node NodePage::node(std::size_t i, int sh_degree) const {
  const auto begin = members_.begin() + (i > 0 ? ends_[i - 1] : 0);
  return {
      cells[i], slots.packed(i, sh_degree), slots.extent[i], {begin, members_.begin() + ends_[i]}};
}

std::size_t NodePage::bytes() const {
  std::size_t bytes = sizeof(*this) + cells.capacity() * sizeof(Cell) +
                      (members_.capacity() + ends_.capacity()) * sizeof(std::uint32_t);
  for (std::size_t band = 1; band < slots.bands.size(); ++band) {
    if (slots.bands[band]) bytes += kSlots * std::size_t(kBandWords[band]) * sizeof(std::uint32_t);
  }
  return bytes;
}

void Levels::inParts(std::size_t count, const std::function<void(std::size_t)>& step) const {
  std::atomic<bool> out_of_memory{false};
  team_->run(static_cast<unsigned>(count), [&](unsigned number, unsigned) {
    try {
      step(number);
    } catch (const std::bad_alloc&) {
      out_of_memory = true;
    }
  });
  if (out_of_memory) throw std::bad_alloc();
}

void Levels::mark(const HostSlots& slots, const SlotRuns& runs) {
  if (!begun_) return;
  for (const auto& [first, count] : runs) {
    for (std::uint32_t slot = first, next; slot < first + count; slot = next) {
      next = std::min(first + count, slot - slot % kSlots + kSlots);
      const SlotPage* const page = slots.index().find(slot);
      if (!page) continue;
      known_.resize(std::max(known_.size(), std::size_t(page->place) + 1));
      std::unique_ptr<Known>& known = known_[page->place];
      if (!known) {
        known = std::make_unique<Known>();
        known->group = page->group;
        known->cells.fill(kNoCell);
      }
      if (known->marked.none()) marked_[known->group].push_back(page->first_slot);
      if (known->group != page->group) known->marked.set();
      for (; slot < next; ++slot) known->marked.set(slot % kSlots);
    }
  }
}

void Levels::clear() {
  begun_ = false;
  known_.clear();
  marked_.clear();
  job_.reset();
  nodes_.clear();
}

bool Levels::advance(HostSlots& slots, const std::function<bool()>& stop,
                     const std::function<void(const std::vector<std::uint32_t>&)>& stand) {
  if (!std::exchange(begun_, true)) {
    for (const SlotPage& page : slots.pages()) mark(slots, {{page.first_slot, kSlots}});
  }
  while (job_ || !marked_.empty()) {
    if (!job_) begin(slots);
    while (job_->level < kLevels) {
      if (stop()) return false;
      const std::size_t left = job_->touched.size() - job_->done;
      if (left == 0) {
        nextLevel();
        continue;
      }
      const std::size_t more = std::min(left, 4 * std::size_t(team_->size()));
      inParts(more,
              [&](std::size_t i) { make(slots, job_->pieces[job_->touched[job_->done + i]]); });
      job_->done += more;
    }
    publish(slots);
    const std::unique_ptr<Job> done = std::move(job_);
    nodes_[done->group] = std::move(done->pages);
    if (stand) stand(done->marked);
  }
  return true;
}

// Finds what has changed since nodes were made last.
void Levels::begin(const HostSlots& slots) {
  const std::uint32_t group = marked_.begin()->first;
  const std::vector<std::uint32_t>& marked = marked_.begin()->second;
  if (nodes_.size() <= group) nodes_.resize(group + 1);
  auto job = std::make_unique<Job>();
  job->group = group;
  const auto byCell = [](const Change& a, const Change& b) {
    return a.cell != b.cell ? a.cell < b.cell : a.slot < b.slot;
  };
  std::vector<Changes> parts(team_->size());
  inParts(parts.size(), [&](std::size_t number) {
    const std::size_t end = marked.size() * (number + 1) / parts.size();
    for (std::size_t i = marked.size() * number / parts.size(); i < end; ++i) {
      findChanges(slots, *slots.index().find(marked[i]), parts[number]);
    }
    std::sort(parts[number].begin(), parts[number].end(), byCell);
  });
  // By twos, side by side.
  for (std::size_t step = 1; step < parts.size(); step *= 2) {
    inParts((parts.size() + step - 1) / (2 * step), [&](std::size_t pair) {
      const Changes first = std::move(parts[2 * step * pair]),
                    second = std::move(parts[2 * step * pair + step]);
      Changes& merged = parts[2 * step * pair];
      merged.resize(first.size() + second.size());
      std::merge(first.begin(), first.end(), second.begin(), second.end(), merged.begin(), byCell);
    });
  }
  // What has gone to other groups stays marked for these.
  auto still_marked = marked_;
  still_marked.erase(group);
  std::vector<std::pair<Known*, std::uint32_t>> regrouped;  // and to which
  for (const std::uint32_t first_slot : marked) {
    const SlotPage& page = *slots.index().find(first_slot);
    if (page.group == group) continue;
    still_marked[page.group].push_back(first_slot);
    regrouped.emplace_back(known_[page.place].get(), page.group);
  }
  job->changes = std::move(parts.front());
  job->marked = marked;
  marked_ = std::move(still_marked);
  job_ = std::move(job);

  // Nothing here needs memory: the job has what was marked.
  inParts(job_->marked.size(),
          [this, &slots](std::size_t i) { know(slots, *slots.index().find(job_->marked[i])); });
  for (const auto& [known, to] : regrouped) {
    known->group = to;
    known->marked.set();
  }
}

// Where a slot enters the group that is known of its page.
Cell Levels::cellOf(const Known& known, const SlotPage& of, const HostSlots::Page& page,
                    std::uint32_t i) {
  const bool shows = of.group == known.group && page.extent[i] >= 0;
  return shows ? entryOf(unpackSlot(page.packed(i, 0).words.data())) : kNoCell;
}

// What is marked is what the nodes will hold.
void Levels::know(const HostSlots& slots, const SlotPage& of) {
  Known& known = *known_[of.place];
  for (std::uint32_t i = 0; i < kSlots; ++i) {
    if (known.marked[i]) known.cells[i] = cellOf(known, of, slots.at(of), i);
  }
  known.marked.reset();
}

void Levels::findChanges(const HostSlots& slots, const SlotPage& of, Changes& changes) const {
  const Known& known = *known_[of.place];
  const HostSlots::Page& page = slots.at(of);
  for (std::uint32_t i = 0; i < kSlots; ++i) {
    if (!known.marked[i]) continue;
    const Cell cell = cellOf(known, of, page, i);
    const Cell before = known.cells[i];
    if (before != cell && before != kNoCell) changes.push_back({before, of.first_slot + i, false});
    if (cell != kNoCell) changes.push_back({cell, of.first_slot + i, true});
  }
}

// Cuts the next level into pieces: where its pages begin, and so that in none more cells are
// touched than a page holds.
void Levels::nextLevel() {
  Job& job = *job_;
  std::vector<Cell> touched;
  for (const Piece& piece : job.pieces) {
    Pages& pages = job.pages[std::size_t(job.level)];
    pages.insert(pages.end(), piece.pages.begin(), piece.pages.end());
    if (job.level + 1 == kLevels) continue;
    std::transform(piece.touched.begin(), piece.touched.end(), std::back_inserter(touched),
                   parentOf);
  }
  job.pieces.clear();
  job.touched.clear();
  job.done = 0;
  if (++job.level == kLevels) return;

  const auto inherited = std::ptrdiff_t(touched.size());
  const Cell level_begin = firstCell(job.level), level_end = firstCell(job.level + 1);
  auto change = changesFrom(job.changes, level_begin);
  for (; change != job.changes.end() && change->cell < level_end; ++change) {
    touched.push_back(change->cell);
  }
  std::inplace_merge(touched.begin(), touched.begin() + inherited, touched.end());
  touched.erase(std::unique(touched.begin(), touched.end()), touched.end());

  const Pages& old = nodes_[job.group][std::size_t(job.level)];
  std::vector<Cell> begins{level_begin};
  for (const auto& page : old) begins.push_back(page->cells.front());
  const auto of_pages = std::ptrdiff_t(begins.size());
  for (std::size_t i = kSlots; i < touched.size(); i += kSlots) begins.push_back(touched[i]);
  std::inplace_merge(begins.begin(), begins.begin() + of_pages, begins.end());
  begins.erase(std::unique(begins.begin(), begins.end()), begins.end());
  begins.push_back(level_end);
  auto next = touched.begin();
  auto page = old.begin();
  for (std::size_t i = 0; i + 1 < begins.size(); ++i) {
    const auto from = next;
    while (next != touched.end() && *next < begins[i + 1]) ++next;
    job.pieces.push_back({begins[i], begins[i + 1], {from, next}, {}});
    const bool whole = page != old.end() && (*page)->cells.front() == begins[i];
    if (from != next || (whole && (*page)->cells.back() >= begins[i + 1])) {
      job.touched.push_back(i);
    } else if (whole) {
      job.pieces.back().pages = {*page};
    }
    if (whole) ++page;
  }
}

// The nodes of a piece: those of touched cells from what is in them, the others as they are.
void Levels::make(const HostSlots& slots, Piece& piece) const {
  const auto level = std::size_t(job_->level);
  const int degree = slots.shDegree();
  NodeCursor old(nodes_[job_->group][level], piece.begin);
  piece.pages.clear();
  std::vector<Node> nodes;
  const auto keepUntil = [&](Cell cell) {
    for (; old.before(cell); old.next()) nodes.push_back(old.node(degree));
  };
  static const Pages kNone;
  const Cell first = piece.touched.empty() ? 0 : piece.touched.front();
  NodeCursor child(level > 0 ? job_->pages[level - 1] : kNone, level > 0 ? childrenOf(first) : 0);
  auto change = changesFrom(job_->changes, first);
  SlotFinder found(slots);
  for (const Cell cell : piece.touched) {
    keepUntil(cell);
    Node node{};
    node.cell = cell;
    std::vector<std::uint32_t> before;
    if (old.before(cell + 1)) {
      before = old.node(degree).members;
      old.next();
    }
    auto member = before.begin();
    for (; change != job_->changes.end() && change->cell == cell; ++change) {
      while (member != before.end() && *member < change->slot) node.members.push_back(*member++);
      if (member != before.end() && *member == change->slot) ++member;
      if (change->enters) node.members.push_back(change->slot);
    }
    node.members.insert(node.members.end(), member, before.end());

    Mixture mixture(cell, degree);
    if (level > 0) {
      const Cell children = childrenOf(cell);
      for (child.skipTo(children); child.before(children + 8); child.next()) {
        mixture.add(child.packed(degree), kMostNodeOpacity);
      }
    }
    for (const std::uint32_t slot : node.members) {
      mixture.add(found.pageOf(slot).packed(slot % kSlots, degree), 1);
    }
    if (mixture.empty()) continue;
    node.packed = mixture.pack();
    node.extent = nodeExtentOf(node.packed);
    nodes.push_back(std::move(node));
  }
  keepUntil(piece.end);
  const std::size_t pages = (nodes.size() + kSlots - 1) / kSlots;
  for (std::size_t i = 0; i < pages; ++i) {
    const std::size_t begin = nodes.size() * i / pages, end = nodes.size() * (i + 1) / pages;
    piece.pages.push_back(
        std::make_shared<NodePage>(&nodes[begin], end - begin, degree, job_->group));
  }
}

// Tells the slots that were marked of their nodes, but for what was written since.
void Levels::publish(HostSlots& slots) const {
  inParts(job_->marked.size(), [&](std::size_t number) {
    const SlotPage& of = *slots.index().find(job_->marked[number]);
    const Known& known = *known_[of.place];
    HostSlots::PerSlot<float> sizes;
    for (std::size_t i = 0; i < kSlots; ++i) {
      const bool stands = !known.marked[i] && known.cells[i] != kNoCell;
      sizes[i] = stands ? cellSize(levelOf(known.cells[i])) : -1;
    }
    slots.setParents(of, sizes);
  });
}

std::size_t Levels::nodes() const {
  std::size_t nodes = 0;
  for (const Nodes& of_group : nodes_) {
    for (const Pages& level : of_group) {
      for (const auto& page : level) nodes += page->cells.size();
    }
  }
  return nodes;
}

std::size_t Levels::bytes() const {
  std::size_t bytes = known_.size() * (sizeof(Known) + sizeof(*HostSlots::Page::parents));
  for (const Nodes& of_group : nodes_) {
    for (const Pages& level : of_group) {
      for (const auto& page : level) bytes += page->bytes();
    }
  }
  return bytes;
}

}  // namespace rosplat
