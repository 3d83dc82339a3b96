// How it works. Space is divided into cubes, twice as wide from level to level. A splat enters at
// the level whose cells are wider than twice its standard deviation. Each cell has a node: one
// Gaussian with the mean, covariance and mean harmonics of what is in it, weighted by opacity and
// area (mixture.hpp). advance() works in steps between which it may stop:
// 1. begin: what changed in marked pages, and the cells that this touches, sorted.
// 2. cut: for each level, touched cells and those around them, as pieces of work.
// 3. make, fill: a piece's nodes anew, from its members and the finer level, in a fixed order.
// 4. nextLevel, until one has at most eight nodes and no splat enters after it; then publish.
// So the result equals, to the bit, that of a map that was built at once.

#include "rosplat_core/levels/levels.hpp"

#include <algorithm>
#include <iterator>
#include <utility>

#include "rosplat_core/threads/in_parts.hpp"

namespace rosplat {

namespace {

constexpr std::uint32_t kSlots = SlotPage::kSlots;
constexpr std::size_t kMostSamples = 1024;  // of a level, of all groups together

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

  // Goes on to the first node whose cell isn't before `from`; never back.
  void skipTo(Cell from) {
    for (; page_ != end_ && (*page_)->cells.back() < from; ++page_) i_ = 0;
    if (page_ == end_) return;
    const std::vector<Cell>& cells = (*page_)->cells;
    i_ = std::size_t(std::lower_bound(cells.begin() + std::ptrdiff_t(i_), cells.end(), from) -
                     cells.begin());
  }
  bool before(Cell cell) const { return page_ != end_ && (*page_)->cells[i_] < cell; }
  const NodePage& page() const { return **page_; }
  std::size_t index() const { return i_; }
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

// Finds the pages of slots that mostly ascend: looks a page up only where it changes.
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

// Divides a level's nodes into equal runs, `most` at most. The node in the middle of each run
// stands for the run.
std::vector<NodeSamples> sampledLevel(const Levels::Pages& pages, std::size_t most) {
  std::size_t nodes = 0;
  for (const auto& page : pages) nodes += page->cells.size();
  const std::size_t count = std::min(nodes, most);
  std::vector<NodeSamples> samples((count + NodeSamples::kCount - 1) / NodeSamples::kCount);
  if (!samples.empty()) samples.back().extent.fill(-1);
  auto page = pages.begin();
  std::size_t before = 0, members_before = 0;  // in the pages before *page
  const auto find = [&](std::size_t node) {    // calls ascend; the end is in the last page
    while (node - before >= (*page)->cells.size() && page + 1 != pages.end()) {
      before += (*page)->cells.size();
      members_before += (*page)->membersBefore((*page)->cells.size());
      ++page;
    }
    return node - before;
  };
  std::size_t begin = 0, members_begin = 0;  // of the run
  for (std::size_t k = 0; k < count; ++k) {
    NodeSamples& of = samples[k / NodeSamples::kCount];
    const std::size_t at = k % NodeSamples::kCount, end = nodes * (k + 1) / count;
    const std::size_t i = find((begin + end) / 2);
    const Cell cell = (*page)->cells[i];
    const auto corner = cornerOf(cell);
    const auto parent = levelOf(cell) + 1 == kLevels ? corner : cornerOf(parentOf(cell));
    for (std::size_t axis = 0; axis < 3; ++axis) {
      of.position[axis][at] = (*page)->slots.position[axis][i];
      of.corner[axis][at] = static_cast<float>(corner[axis]);
      of.parent_corner[axis][at] = static_cast<float>(parent[axis]);
    }
    of.extent[at] = (*page)->slots.extent[i];
    const std::size_t in_page = find(end);
    const std::size_t members_end = members_before + (*page)->membersBefore(in_page);
    of.nodes[at] = static_cast<float>(end - begin);
    of.members[at] = static_cast<float>(members_end - members_begin);
    begin = end;
    members_begin = members_end;
  }
  return samples;
}

// Appends a cell, unless it equals the last one.
void append(std::vector<Cell>& cells, Cell cell) {
  if (cells.empty() || cells.back() != cell) cells.push_back(cell);
}

}  // namespace

NodePage::NodePage(int sh_degree, std::uint32_t group) : sh_degree_(sh_degree) {
  bounds.first_slot = kNoSlot;
  bounds.group = group;
  slots.extent.fill(-1);
}

void NodePage::add(Cell cell, const PackedSlot& packed, const std::uint32_t* members,
                   std::size_t count) {
  const std::size_t i = cells.size();
  slots.put(i, packed, sh_degree_);
  slots.extent[i] = nodeExtentOf(packed);
  const auto& [x, y, z] = slots.position;
  bounds.widen({x[i], y[i], z[i]}, slots.extent[i]);
  cells.push_back(cell);
  members_.insert(members_.end(), members, members + count);
  ends_.push_back(static_cast<std::uint32_t>(members_.size()));
}

std::pair<const std::uint32_t*, std::size_t> NodePage::membersOf(std::size_t i) const {
  const std::size_t begin = membersBefore(i);
  return {members_.data() + begin, ends_[i] - begin};
}

Node NodePage::node(std::size_t i, int sh_degree) const {
  const auto [members, count] = membersOf(i);
  return {cells[i], slots.packed(i, sh_degree), slots.extent[i], {members, members + count}};
}

std::size_t NodePage::bytes() const {
  return sizeof(*this) + slots.appearanceBytes() + cells.capacity() * sizeof(Cell) +
         (members_.capacity() + ends_.capacity()) * sizeof(std::uint32_t);
}

void Levels::mark(const HostSlots& slots, const SlotRuns& runs) {
  if (!begun_) return;
  forEachPart(runs, [&](std::uint32_t slot, std::uint32_t count, std::size_t) {
    const SlotPage* const page = slots.index().find(slot);
    if (!page) return;
    known_.resize(std::max(known_.size(), std::size_t(page->place) + 1));
    std::unique_ptr<Known>& known = known_[page->place];
    if (!known) {
      known = std::make_unique<Known>();
      known->group = page->group;
      known->cells.fill(kNoCell);
    }
    if (known->marked.none()) marked_[known->group].push_back(page->first_slot);
    if (known->group != page->group || count == kSlots) {
      known->marked.set();
    } else {
      for (std::uint32_t i = 0; i < count; ++i) known->marked.set(slot % kSlots + i);
    }
  });
}

void Levels::clear() {
  begun_ = false;
  known_.clear();
  marked_.clear();
  job_.reset();
  nodes_.clear();
  entering_.clear();
  samples_.clear();
}

bool Levels::advance(HostSlots& slots, const std::function<bool()>& stop,
                     const std::function<void(const std::vector<std::uint32_t>&)>& stand) {
  if (!std::exchange(begun_, true)) {
    try {
      for (const SlotPage& page : slots.pages()) mark(slots, {{page.first_slot, kSlots}});
    } catch (const std::bad_alloc&) {  // all is marked, or nothing
      clear();
      throw;
    }
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
      make(slots, std::min(left, 4 * std::size_t(team_->size())));
    }
    LevelSamples samples = sampled(job_->pages, job_->group);
    publish(slots);
    const std::unique_ptr<Job> done = std::move(job_);
    nodes_[done->group] = std::move(done->pages);
    entering_[done->group] = done->entering;
    samples_[done->group] = std::move(samples);
    if (stand) stand(done->marked);
  }
  return true;
}

// Begins a job: finds what has changed in the next group since its nodes were made last.
void Levels::begin(const HostSlots& slots) {
  auto next = marked_.lower_bound(next_group_);
  if (next == marked_.end()) next = marked_.begin();
  const std::uint32_t group = next->first;
  const std::vector<std::uint32_t>& marked = next->second;
  next_group_ = group + 1;
  if (nodes_.size() <= group) nodes_.resize(group + 1);
  samples_.resize(nodes_.size());
  entering_.resize(nodes_.size());
  auto job = std::make_unique<Job>();
  job->group = group;
  std::vector<FoundChanges> parts(4 * std::size_t(team_->size()));
  inParts(team_.get(), parts.size(), [&](std::size_t number) {
    const std::size_t first = marked.size() * number / parts.size();
    const std::size_t end = marked.size() * (number + 1) / parts.size();
    parts[number].all.reserve((end - first) * kSlots);
    for (std::size_t i = first; i < end; ++i) {
      findChanges(slots, *slots.index().find(marked[i]), parts[number]);
    }
  });
  job->changes = sorted(parts);
  job->entering = entering_[group];
  for (const FoundChanges& found : parts) {
    for (std::size_t level = 0; level < found.more.size(); ++level) {
      job->entering[level] += found.more[level];
    }
  }
  // Pages that now belong to other groups stay marked, for those groups.
  std::map<std::uint32_t, std::vector<std::uint32_t>> still_marked;
  std::vector<std::pair<Known*, std::uint32_t>> regrouped;  // and the new group
  for (const std::uint32_t first_slot : marked) {
    const SlotPage& page = *slots.index().find(first_slot);
    if (page.group == group) continue;
    still_marked[page.group].push_back(first_slot);
    regrouped.emplace_back(known_[page.place].get(), page.group);
  }
  for (auto& [of, pages] : still_marked) {
    std::vector<std::uint32_t>& all = marked_[of];
    all.reserve(all.size() + pages.size());
  }
  // Nothing from here on needs memory, so the job takes all marks or, after a throw, none.
  for (const auto& [of, pages] : still_marked) {
    marked_[of].insert(marked_[of].end(), pages.begin(), pages.end());
  }
  job->marked = std::move(next->second);
  marked_.erase(next);
  job_ = std::move(job);
  inParts(team_.get(), job_->marked.size(), [this, &slots](std::size_t i) {
    rememberCells(slots, *slots.index().find(job_->marked[i]));
  });
  for (const auto& [known, to] : regrouped) {
    known->group = to;
    known->marked.set();
  }
}

// The cell at which a slot enters the lattice of known.group; kNoCell if it has left that group.
Cell Levels::cellOf(const Known& known, const SlotPage& of, const HostSlots::Page& page,
                    std::uint32_t i) {
  if (of.group != known.group || page.extent[i] < 0) return kNoCell;
  std::array<std::uint32_t, 5> words;  // largestScale() reads no more
  for (std::size_t k = 0; k < words.size(); ++k) words[k] = page.word(k, i);
  return entryOf({page.position[0][i], page.position[1][i], page.position[2][i]},
                 largestScale(words.data()));
}

// Notes that the nodes will hold the marked slots as they are now.
void Levels::rememberCells(const HostSlots& slots, const SlotPage& of) {
  Known& known = *known_[of.place];
  for (std::uint32_t i = 0; i < kSlots; ++i) {
    if (known.marked[i]) known.cells[i] = cellOf(known, of, slots.at(of), i);
  }
  known.marked.reset();
}

void Levels::findChanges(const HostSlots& slots, const SlotPage& of, FoundChanges& found) const {
  const Known& known = *known_[of.place];
  const HostSlots::Page& page = slots.at(of);
  for (std::uint32_t i = 0; i < kSlots; ++i) {
    if (!known.marked[i]) continue;
    const Cell cell = cellOf(known, of, page, i);
    const Cell before = known.cells[i];
    if (before != kNoCell) --found.more[std::size_t(levelOf(before))];
    if (before != cell && before != kNoCell) {
      found.all.push_back({before, of.first_slot + i, false});
    }
    if (cell == kNoCell) continue;
    ++found.more[std::size_t(levelOf(cell))];
    found.all.push_back({cell, of.first_slot + i, true});
  }
}

// A sample sort: deals the changes out to ranges of cells, then sorts the ranges side by side.
Levels::Changes Levels::sorted(const std::vector<FoundChanges>& parts) const {
  constexpr std::size_t kSamples = 32;  // of a part
  std::vector<Cell> samples, ends;      // ends: of the ranges but the last
  Changes changes;
  for (const FoundChanges& part : parts) {
    changes.count += part.all.size();
    for (std::size_t i = 0; i < part.all.size(); i += part.all.size() / kSamples + 1) {
      samples.push_back(part.all[i].cell);
    }
  }
  std::sort(samples.begin(), samples.end());
  const std::size_t ranges = parts.size();
  for (std::size_t i = 1; i < ranges && !samples.empty(); ++i) {
    ends.push_back(samples[samples.size() * i / ranges]);
  }

  const auto rangeOf = [&ends](const Change& change) {
    return std::size_t(std::upper_bound(ends.begin(), ends.end(), change.cell) - ends.begin());
  };
  std::vector<std::size_t> next(ranges * parts.size());  // where to write, by range, then part
  inParts(team_.get(), parts.size(), [&](std::size_t part) {
    for (const Change& change : parts[part].all) ++next[rangeOf(change) * parts.size() + part];
  });
  std::size_t sum = 0;
  for (std::size_t& place : next) sum += std::exchange(place, sum);
  std::vector<std::size_t> begins{next};
  changes.all.reset(new Change[changes.count]);
  inParts(team_.get(), parts.size(), [&](std::size_t part) {
    for (const Change& change : parts[part].all) {
      changes.all[next[rangeOf(change) * parts.size() + part]++] = change;
    }
  });
  std::vector<std::vector<Cell>> cells(ranges);
  inParts(team_.get(), ranges, [&](std::size_t range) {
    const std::size_t begin = begins[range * parts.size()];
    const std::size_t end = range + 1 < ranges ? begins[(range + 1) * parts.size()] : changes.count;
    std::sort(&changes.all[begin], changes.all.get() + end, [](const Change& a, const Change& b) {
      return a.cell != b.cell ? a.cell < b.cell : a.slot < b.slot;
    });
    for (std::size_t i = begin; i < end; ++i) append(cells[range], changes.all[i].cell);
  });
  for (const std::vector<Cell>& of_range : cells) {
    changes.cells.insert(changes.cells.end(), of_range.begin(), of_range.end());
  }
  return changes;
}

// Puts the finished level away and cuts the next one into pieces: where its old pages begin, and so
// that no piece has more touched cells than a page holds.
void Levels::nextLevel() {
  Job& job = *job_;
  Pages pages;  // of the finished level
  for (const Piece& piece : job.pieces) {
    pages.insert(pages.end(), piece.pages.begin(), piece.pages.end());
  }
  std::vector<Cell> cells;
  std::vector<Piece> pieces;
  std::vector<std::size_t> touched_pieces;
  const bool last = isLast(pages);
  if (!last) {
    cells = touchedCells(job.level + 1, pages);
    cut(job.level + 1, cells, pieces, touched_pieces);
  }
  // From here on, nothing needs memory.
  if (job.level >= 0) job.pages[std::size_t(job.level)] = std::move(pages);
  job.pieces = std::move(pieces);
  job.cells = std::move(cells);
  job.touched = std::move(touched_pieces);
  job.done = 0;
  job.level = last ? kLevels : job.level + 1;
}

// Whether a level of these pages, which the job has just finished, is the group's last one.
bool Levels::isLast(const Pages& pages) const {
  std::size_t nodes = 0;
  for (const auto& page : pages) nodes += page->cells.size();
  const auto coarser = job_->entering.begin() + job_->level + 1;
  const bool more =
      std::any_of(coarser, job_->entering.end(), [](auto count) { return count > 0; });
  return job_->level + 1 == kLevels || (!more && nodes <= kFewestNodes);
}

// The cells of a level that have changes, or a child that was touched; of a new level, all.
// finer: the pages of the level before.
std::vector<Cell> Levels::touchedCells(int level, const Pages& finer) const {
  std::vector<Cell> parents, touched;
  if (nodes_[job_->group][std::size_t(level)].empty()) {
    for (const auto& page : finer) {
      for (const Cell cell : page->cells) append(parents, parentOf(cell));
    }
  } else {
    for (const Piece& piece : job_->pieces) {
      parents.insert(parents.end(), piece.parents.begin(), piece.parents.end());
    }
  }
  const std::vector<Cell>& changed = job_->changes.cells;
  const auto begin = std::lower_bound(changed.begin(), changed.end(), firstCell(level));
  const auto end = std::lower_bound(begin, changed.end(), firstCell(level + 1));
  touched.reserve(parents.size() + std::size_t(end - begin));
  // Pieces that are neighbours may have touched the same parent.
  parents.erase(std::unique(parents.begin(), parents.end()), parents.end());
  std::set_union(parents.begin(), parents.end(), begin, end, std::back_inserter(touched));
  return touched;
}

void Levels::cut(int level, const std::vector<Cell>& touched, std::vector<Piece>& pieces,
                 std::vector<std::size_t>& touched_pieces) const {
  const Job& job = *job_;
  const Cell level_begin = firstCell(level), level_end = firstCell(level + 1);
  const Pages& old = nodes_[job.group][std::size_t(level)];
  std::vector<Cell> begins{level_begin};
  for (const auto& page : old) begins.push_back(page->cells.front());
  const auto of_pages = std::ptrdiff_t(begins.size());
  for (std::size_t i = kSlots; i < touched.size(); i += kSlots) begins.push_back(touched[i]);
  std::inplace_merge(begins.begin(), begins.begin() + of_pages, begins.end());
  begins.erase(std::unique(begins.begin(), begins.end()), begins.end());
  begins.push_back(level_end);
  const Cell *next = touched.data(), *const end = next + touched.size();
  auto page = old.begin();
  for (std::size_t i = 0; i + 1 < begins.size(); ++i) {
    const Cell* const from = next;
    next = std::lower_bound(from, end, begins[i + 1]);
    pieces.push_back({begins[i], begins[i + 1], from, next, {}, {}});
    const bool whole = page != old.end() && (*page)->cells.front() == begins[i];
    if (from != next || (whole && (*page)->cells.back() >= begins[i + 1])) {
      touched_pieces.push_back(i);
    } else if (whole) {
      pieces.back().pages = {*page};
    }
    if (whole) ++page;
  }
}

// Makes the next `count` touched pieces: their nodes side by side, then the pages of each piece.
void Levels::make(const HostSlots& slots, std::size_t count) {
  constexpr std::size_t kCells = 64;
  Job& job = *job_;
  struct CellRun {
    std::size_t piece, begin;
  };
  std::vector<CellRun> parts;
  std::vector<std::vector<Made>> made(count);
  const auto piece = [&](std::size_t i) -> Piece& { return job.pieces[job.touched[job.done + i]]; };
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t begin = 0; begin < piece(i).count(); begin += kCells) {
      parts.push_back({i, begin});
    }
    made[i].resize((piece(i).count() + kCells - 1) / kCells);
  }
  inParts(team_.get(), parts.size(), [&](std::size_t number) {
    const auto& [i, begin] = parts[number];
    const std::size_t end = std::min(begin + kCells, piece(i).count());
    made[i][begin / kCells] = nodesOf(slots, piece(i), begin, end);
  });
  inParts(team_.get(), count, [&](std::size_t i) {
    fill(piece(i), made[i], slots.shDegree());
    made[i] = {};
    piece(i).parents.clear();
    if (job.level + 1 == kLevels) return;
    for (const Cell* cell = piece(i).touched; cell != piece(i).touched_end; ++cell) {
      append(piece(i).parents, parentOf(*cell));
    }
  });
  job.done += count;
}

// Merges the nodes of touched cells begin to end of a piece.
Levels::Made Levels::nodesOf(const HostSlots& slots, const Piece& piece, std::size_t begin,
                             std::size_t end) const {
  static const Pages kNone;
  const auto level = std::size_t(job_->level);
  const int degree = slots.shDegree();
  const Cell first = piece.touched[begin], *const last_cell = piece.touched + end;
  NodeCursor old(nodes_[job_->group][level], first);
  const Cell* const parent =
      level > 0 ? std::find_if(piece.touched + begin, last_cell, hasChildren) : last_cell;
  NodeCursor child(parent != last_cell ? job_->pages[level - 1] : kNone,
                   parent != last_cell ? childrenOf(*parent) : 0);
  auto change = changesFrom(job_->changes, first);
  SlotFinder found(slots);
  Made made;
  made.cells.reserve(end - begin);
  made.packed.reserve(end - begin);
  made.ends.reserve(end - begin);
  for (std::size_t i = begin; i < end; ++i) {
    const Cell cell = piece.touched[i];
    const std::size_t before = made.members.size();
    const std::uint32_t *member = nullptr, *last = nullptr;
    old.skipTo(cell);
    if (old.before(cell + 1)) {
      const auto [members, count] = old.page().membersOf(old.index());
      member = members;
      last = members + count;
    }
    for (; change != job_->changes.end() && change->cell == cell; ++change) {
      while (member != last && *member < change->slot) made.members.push_back(*member++);
      if (member != last && *member == change->slot) ++member;
      if (change->enters) made.members.push_back(change->slot);
    }
    made.members.insert(made.members.end(), member, last);

    Mixture mixture(cell, degree);
    if (level > 0 && hasChildren(cell)) {
      const Cell children = childrenOf(cell);
      for (child.skipTo(children); child.before(children + 8); child.next()) {
        mixture.add(child.packed(degree), kMostNodeOpacity);
      }
    }
    for (std::size_t k = before; k < made.members.size(); ++k) {
      const std::uint32_t slot = made.members[k];
      mixture.add(found.pageOf(slot).packed(slot % kSlots, degree), 1);
    }
    if (mixture.empty()) {  // nothing is left in the cell
      made.members.resize(before);
      continue;
    }
    made.cells.push_back(cell);
    made.packed.push_back(mixture.pack());
    made.ends.push_back(static_cast<std::uint32_t>(made.members.size()));
  }
  return made;
}

// Fills the pages of a piece: with the new nodes of touched cells and the old nodes of the others.
void Levels::fill(Piece& piece, const std::vector<Made>& made, int sh_degree) const {
  struct Source {
    const NodePage* page;  // of an old node; null: it was made
    const Made* made;
    std::size_t i;
  };
  std::vector<Source> sources;
  NodeCursor old(nodes_[job_->group][std::size_t(job_->level)], piece.begin);
  const Cell* touched = piece.touched;
  const auto keepUntil = [&](Cell cell) {
    for (; old.before(cell); old.next()) {
      const Cell kept = old.page().cells[old.index()];
      while (touched != piece.touched_end && *touched < kept) ++touched;
      if (touched != piece.touched_end && *touched == kept) continue;
      sources.push_back({&old.page(), nullptr, old.index()});
    }
  };
  for (const Made& part : made) {
    for (std::size_t i = 0; i < part.cells.size(); ++i) {
      keepUntil(part.cells[i]);
      sources.push_back({nullptr, &part, i});
    }
  }
  keepUntil(piece.end);

  const std::size_t pages = (sources.size() + kSlots - 1) / kSlots;
  piece.pages.clear();
  for (std::size_t number = 0; number < pages; ++number) {
    auto page = std::make_shared<NodePage>(sh_degree, job_->group);
    const std::size_t end = sources.size() * (number + 1) / pages;
    for (std::size_t k = sources.size() * number / pages; k < end; ++k) {
      const auto& [kept, part, i] = sources[k];
      if (kept) {
        const auto [members, count] = kept->membersOf(i);
        page->add(kept->cells[i], kept->slots.packed(i, sh_degree), members, count);
      } else {
        const std::uint32_t first = i > 0 ? part->ends[i - 1] : 0;
        page->add(part->cells[i], part->packed[i], part->members.data() + first,
                  part->ends[i] - first);
      }
    }
    piece.pages.push_back(std::move(page));
  }
}

// Sets the parents of the job's slots, but none of slots that were written since the job began.
void Levels::publish(HostSlots& slots) const {
  inParts(team_.get(), job_->marked.size(), [&](std::size_t number) {
    slots.makeParents(*slots.index().find(job_->marked[number]));
  });
  // Nothing here needs memory, so all slots get their parents or, after a throw, none does.
  inParts(team_.get(), job_->marked.size(), [&](std::size_t number) {
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

// A group gets samples by its share of the map: an estimate reads those of all groups.
LevelSamples Levels::sampled(const Nodes& nodes, std::uint32_t group) const {
  std::size_t all = 0, own = 0;  // pages of slots
  for (const std::unique_ptr<Known>& known : known_) {
    if (!known) continue;
    ++all;
    own += std::size_t(known->group == group);
  }
  const std::size_t most = std::max(kMostSamples * own / all, NodeSamples::kCount);
  LevelSamples samples;
  inParts(team_.get(), nodes.size(),
          [&](std::size_t level) { samples[level] = sampledLevel(nodes[level], most); });
  return samples;
}

float parentSize(const Levels::Nodes& nodes, int level) {
  const auto around = std::size_t(level) + 1;
  return around < nodes.size() && !nodes[around].empty() ? cellSize(level + 1) : kBoundless;
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
  std::size_t bytes = known_.size() * sizeof(Known);
  for (const Nodes& of_group : nodes_) {
    for (const Pages& level : of_group) {
      for (const auto& page : level) bytes += page->bytes();
    }
  }
  return bytes;
}

}  // namespace rosplat
