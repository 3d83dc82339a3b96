#include "gpu/slot_reader.hpp"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>

#include "gl/buffer.hpp"

namespace rosplat {

namespace {

constexpr std::size_t kWord = sizeof(std::uint32_t);

// words: a row, with the slot's channels behind it.
SplatValues unpack(std::uint32_t slot, const Group& group, const std::uint32_t* words,
                   int sh_degree, std::size_t channels) {
  SplatValues values = valuesOf(slot, group, words, sh_degree, bandsOf(words));
  values.channels.resize(channels);
  const std::uint32_t* const further = words + rowWords(sh_degree);
  if (channels > 0) std::memcpy(values.channels.data(), further, channels * kWord);
  return values;
}

}  // namespace

std::vector<SplatValues> SlotReader::read(const SlotStore& store,
                                          const std::vector<std::uint32_t>& slots) const {
  struct Held {
    std::size_t index;  // in slots
    std::uint32_t arena, place;
    const Group* group;
  };
  std::vector<SplatValues> values(slots.size());
  std::vector<Held> held;  // sorted by arena; slots that no page holds stay empty
  for (std::size_t i = 0; i < slots.size(); ++i) {
    values[i].slot = slots[i];
    const SlotPage* const page = store.pages().find(slots[i]);
    if (!page || !store.holds(*page)) continue;
    const SlotStore::Place place = store.placeOf(*page);
    held.push_back({i, place.arena, place.page * SlotPage::kSlots + slots[i] % SlotPage::kSlots,
                    &store.pages().groupOf(*page)});
  }
  if (held.empty()) return values;
  std::sort(held.begin(), held.end(), [](auto& a, auto& b) { return a.arena < b.arena; });

  const std::size_t stride = std::size_t(rowWords(store.shDegree())) + store.channels();
  std::vector<std::uint32_t> words(held.size());
  std::transform(held.begin(), held.end(), words.begin(), [](const Held& of) { return of.place; });
  gl::Buffer wanted(words.size() * kWord, GL_STREAM_DRAW);
  const gl::Buffer gathered(held.size() * stride * kWord, GL_STREAM_READ);
  gl::settle();
  wanted.write(0, words.data(), wanted.bytes());
  words.resize(held.size() * stride);

  gather_.use();
  gather_.bind("Wanted", wanted);
  gather_.bind("Gathered", gathered);
  gather_.set("stride", static_cast<GLuint>(stride));
  for (std::size_t first = 0, next = 0; first < held.size(); first = next) {
    while (next < held.size() && held[next].arena == held[first].arena) ++next;
    const SlotStore::Arena& arena = store.arenas()[held[first].arena];
    gather_.set("first", static_cast<GLuint>(first));
    gather_.set("count", static_cast<GLuint>(next - first));
    GLuint offset = 0;
    const auto gather = [&](std::size_t words_of_each, const gl::Buffer& held_there) {
      if (!held_there.id()) return;
      const auto size = static_cast<GLuint>(words_of_each);
      gather_.bind("Held", held_there);
      gather_.set("words", size);
      gather_.set("offset", offset);
      gl::dispatchInvocations((next - first) * size);
      offset += size;
    };
    forEachArray(gather, arena);
  }
  gl::storageBarrier();
  gathered.read(0, words.data(), gathered.bytes());
  for (std::size_t k = 0; k < held.size(); ++k) {
    const std::size_t i = held[k].index;
    values[i] =
        unpack(slots[i], *held[k].group, &words[k * stride], store.shDegree(), store.channels());
  }
  return values;
}

PackedRun PageReader::read(const SlotStore& store, std::size_t first, std::size_t most,
                           PackedRun run) {
  const std::vector<SlotPage>& all = store.pages().pages();
  const SlotPage& page = all[first];
  const SlotStore::Place place = store.placeOf(page);
  const auto follows = [&](std::size_t i) {
    const SlotPage& next = all[first + i];
    const SlotStore::Place at = store.placeOf(next);
    return store.holds(next) && next.group == page.group && at.arena == place.arena &&
           at.page == place.page + i && next.first_slot == page.first_slot + i * SlotPage::kSlots;
  };
  std::size_t pages = 1;
  while (pages < most && first + pages < all.size() && follows(pages)) ++pages;
  run.group = store.pages().groupOf(page);
  run.first_slot = page.first_slot;
  run.sh_degree = store.shDegree();
  const SlotStore::Arena& arena = store.arenas()[place.arena];
  const std::size_t slots = pages * SlotPage::kSlots;
  std::size_t total = 0;  // words
  const auto makeRoom = [&](std::size_t words, const gl::Buffer& from, auto& values) {
    values.resize(from.id() ? slots * words : 0);
    total += values.size();
  };
  forEachArray(makeRoom, arena, run);
  if (!copy_ || copy_->bytes() < total * kWord) {
    copy_.emplace(total);
    gl::settle();
  }
  std::size_t to = 0;
  const auto ask = [&](std::size_t words, const gl::Buffer& from, const auto& values) {
    if (values.empty()) return;
    const std::size_t first_word = place.page * SlotPage::kSlots * words;
    copy_->ask(from, first_word * kWord, values.size() * kWord, to);
    to += values.size() * kWord;
  };
  forEachArray(ask, arena, run);
  const GLuint* words = copy_->wait();
  const auto copy = [&words](std::size_t, auto& values) {
    if (!values.empty()) std::memcpy(values.data(), words, values.size() * kWord);
    words += values.size();
  };
  forEachArray(copy, run);
  return run;
}

}  // namespace rosplat
