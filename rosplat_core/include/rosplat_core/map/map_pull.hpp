#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "rosplat_core/map/gaussian_batch.hpp"

namespace rosplat {

// What a receiver of a map asks its publisher for, and when: all that it lacks, until it has it.
// The class follows the batches of a map, which may be of any type, by their labels. All times are
// of one monotonic clock.
//
// An answer is the map as it is at that moment, in parts, block by block. The map goes on changing
// meanwhile, and what is heard waits. Once all blocks are there, a round has ended: each block is
// as it was at the first answer of the round, or at a later one. A pull ends with a round
// - in which the map did not change, or
// - of which all changes wait: applied in turn, they make the map that of the last answer.
// Otherwise the next round asks for what has changed since the last one began. At the end of a pull
// the map is that of one revision, and what was heard above that follows. Where nothing can be
// pulled, batches are taken as they come.
//
// A receiver that knows no map asks for whichever there is. It asks now and then even where no
// server is known: ROS tells late of a server, and of none while one of several is half known.
// A receiver that hears nothing for a while asks whether it has all: the last batch may be lost.
template <typename Batch>
class MapPull {
 public:
  // From one beginning of a round to the next, and after an answer that takes less than kSmall. [s]
  static constexpr double kPause = 0.1;
  static constexpr std::size_t kSmall = 1u << 14;  // [bytes]
  static constexpr int kMostRounds = 32;           // of a pull, before what was heard has its turn
  // With an answer, for a server may not know a new client yet; doubles up to the most. [s]
  static constexpr double kPatience = 1.0, kMostPatience = 4.0;
  static constexpr double kOthers = 0.5;  // with others' answers, once a server had none [s]
  static constexpr double kRetry = 1.0;   // after a pull that came to nothing [s]
  // From one request to the next where nobody seems to answer any. [s]
  static constexpr double kBlind = 2.0;
  // Without a batch or an answer, until it is asked whether one got lost. [s]
  static constexpr double kQuiet = 2.0;
  // Of what is heard while all before is pulled. [bytes]
  static constexpr std::size_t kMostWaiting = std::size_t(1) << 26;
  static constexpr std::uint32_t kBlocks = 1u << 15;  // of slots, in a map

  // What counts of a batch.
  struct Label {
    std::string map_id;
    std::uint64_t revision = 0;
    bool replaces = false;
    std::size_t bytes = 0;
  };
  struct Labelled {
    Label label;
    Batch batch;
  };
  // What to ask for, as in PullMap; the number is what its answers are to be handed in with.
  struct Request {
    std::uint64_t number = 0;
    std::string map_id;
    std::uint64_t after_revision = 0;
    std::uint32_t first_block = 0;
  };
  // What to do now: batches to apply in turn, and a request to send.
  struct Step {
    std::vector<std::pair<Batch, Arrival>> batches;
    std::optional<Request> request;
  };

  // A batch from the topic. served: whether somebody answers requests.
  Step hear(Labelled heard, double now, bool served) {
    Step step;
    const Label& label = heard.label;
    if (label.revision == 0) {  // will be refused
      step.batches.emplace_back(std::move(heard.batch), Arrival::kHeard);
      return step;
    }
    note(label);
    check_from_ = now + kQuiet;
    follow(std::move(heard), now, served || answered_, step);
    ask(now, served, step);
    return step;
  }

  // A batch from the topic that there was no room for: it is pulled.
  void miss(const Label& label) {
    if (label.revision == 0) return;
    note(label);
    exact_ = false;
  }

  // An answer to a request, of which several servers may send one each. One to an earlier request
  // is ignored, and so is one after the first that has batches.
  Step answer(std::uint64_t number, std::vector<Labelled> batches, std::uint32_t next_block,
              double now, bool served) {
    Step step;
    if (!asked_ || number != number_) return step;
    if (batches.empty()) {  // of a server without this map, where another may have it
      refused_ = true;
      patience_ = std::min(patience_, now - *asked_ + kOthers);
      return step;
    }
    asked_.reset();
    if (!lacks() && !pulling_ && batches.front().label.map_id == *map_id_ &&
        batches.front().label.revision <= revision_) {
      return step;  // nothing got lost
    }
    if (!isSound(batches, next_block)) {
      giveUp(now, step);
      return step;
    }
    ended_at_ = 0;
    pulling_ = answered_ = true;
    refused_ = false;
    patience_ = kPatience;
    const Label first = batches.front().label;
    map_id_ = first.map_id;
    if (first.replaces) base_ = block_ = 0;
    if (block_ == 0) {
      round_ = first.revision;
      ++rounds_;
      while (!waiting_.empty() && waiting_.front().label.revision <= round_) dropFirst();
    }
    revision_ = first.revision;
    std::size_t bytes = 0;
    for (Labelled& each : batches) {
      bytes += each.label.bytes;
      step.batches.emplace_back(std::move(each.batch), Arrival::kPulled);
    }
    block_ = next_block;
    if (next_block != 0) {
      ask_from_ = bytes < kSmall ? now + kPause : now;
    } else {
      base_ = round_;
      ended_at_ = first.revision;
    }
    if (!finish(now, step) && rounds_ > kMostRounds) giveUp(now, step);
    ask(now, served, step);
    return step;
  }

  // To be called several times a second.
  Step tick(double now, bool served) {
    Step step;
    const bool late = asked_ && now > *asked_ + patience_;
    const bool hopeless = late && (refused_ || patience_ >= kMostPatience);
    if (pulling_ && (hopeless || !(served || answered_))) {
      giveUp(now, step);
    } else if (late) {
      patience_ = std::min(2 * patience_, kMostPatience);
      asked_.reset();
    }
    ask(now, served, step);
    return step;
  }

  // Whether something is missing that is on its way.
  bool pulling() const { return pulling_; }

  bool held = false;  // Whether to ask for nothing, because there is no room for answers.

 private:
  static constexpr double kNever = -std::numeric_limits<double>::infinity();

  void note(const Label& label) {
    if (label.map_id != map_id_) {
      if (map_id_) stop();
      begin(label.map_id);
    }
    const bool again = label.revision <= heard_;  // played once more, by a bag
    heard_ = label.revision;
    if (!again) return;
    stop();
    revision_ = label.revision - 1;
    base_ = 0;
    exact_ = label.replaces;
  }

  // What was asked for while no map was known may be this one.
  void begin(const std::string& map_id) {
    map_id_ = map_id;
    heard_ = revision_ = base_ = 0;
    exact_ = true;  // nothing is missing of an empty map
    retry_from_ = kNever;
  }

  void stop() {
    pulling_ = false;
    asked_.reset();
    refused_ = false;
    patience_ = kPatience;
    block_ = 0;
    rounds_ = 0;
    ended_at_ = 0;
    waiting_.clear();
    waiting_bytes_ = 0;
  }

  void follow(Labelled heard, double now, bool served, Step& step) {
    const Label& label = heard.label;
    if (pulling_ && !label.replaces) {
      if (label.revision > round_) wait(std::move(heard));
      finish(now, step);
      return;
    }
    if (label.revision <= revision_) return;  // what was pulled has overtaken it
    if (label.replaces) {
      stop();
      exact_ = true;
    } else if (label.revision - revision_ > 1) {
      if (served && now >= retry_from_) {
        pull();
        return wait(std::move(heard));
      }
      exact_ = false;
    }
    revision_ = label.revision;
    if (exact_) base_ = label.revision;
    step.batches.emplace_back(std::move(heard.batch), Arrival::kHeard);
  }

  void pull() {
    pulling_ = true;
    round_ = revision_;
    asked_.reset();  // what was asked for blindly may be lost
    patience_ = kPatience;
  }

  void wait(Labelled heard) {
    waiting_bytes_ += heard.label.bytes;
    waiting_.push_back(std::move(heard));
    // The oldest go: what then lacks is a gap.
    while (waiting_bytes_ > kMostWaiting && waiting_.size() > 1) dropFirst();
  }

  void dropFirst() {
    waiting_bytes_ -= waiting_.front().label.bytes;
    waiting_.pop_front();
  }

  // Ends the pull where a round has ended, and all that changed in its course is there.
  bool finish(double now, Step& step) {
    if (ended_at_ == 0) return false;
    std::uint64_t known = base_;
    for (const Labelled& heard : waiting_) {
      if (known < ended_at_ && heard.label.revision == known + 1) ++known;
    }
    if (known < ended_at_) return false;
    while (!waiting_.empty() && waiting_.front().label.revision <= ended_at_) {
      step.batches.emplace_back(std::move(waiting_.front().batch), Arrival::kPulled);
      dropFirst();
    }
    step.batches.back().second = Arrival::kLast;
    goOn(now, step);
    return true;
  }

  // With what was heard meanwhile, all before it being there.
  void goOn(double now, Step& step) {
    std::deque<Labelled> waiting = std::move(waiting_);
    stop();
    exact_ = true;
    for (Labelled& heard : waiting) follow(std::move(heard), now, true, step);
    if (revision_ < heard_ && !pulling_) exact_ = false;  // there was no room for the last
  }

  void giveUp(double now, Step& step) {
    std::deque<Labelled> waiting = std::move(waiting_);
    stop();
    exact_ = answered_ = false;
    retry_from_ = now + kRetry;
    for (Labelled& heard : waiting) follow(std::move(heard), now, false, step);
  }

  void ask(double now, bool served, Step& step) {
    if (lacks() && (served || answered_) && now >= retry_from_ && !pulling_) pull();
    const bool blind = lacks() && !pulling_ && now >= std::max(blind_from_, retry_from_);
    const bool checks = !lacks() && !pulling_ && served && now >= check_from_;
    if (held || asked_ || !(blind || checks || (pulling_ && now >= ask_from_))) return;
    if (block_ == 0) ask_from_ = now + kPause;
    check_from_ = now + kQuiet;
    blind_from_ = now + kBlind;
    asked_ = now;
    step.request = Request{++number_, map_id_.value_or(""), base_, block_};
  }

  bool lacks() const { return !exact_ || !map_id_; }

  bool isSound(const std::vector<Labelled>& batches, std::uint32_t next_block) const {
    const Label& first = batches.front().label;
    if (first.revision < std::max<std::uint64_t>(1, revision_)) return false;
    const std::uint32_t block = first.replaces ? 0 : block_;
    if (next_block != 0 && (next_block <= block || next_block >= kBlocks)) return false;
    const std::string& map_id = map_id_ ? *map_id_ : first.map_id;
    return std::all_of(batches.begin(), batches.end(), [&](const Labelled& each) {
      return each.label.map_id == map_id && each.label.revision == first.revision;
    });
  }

  std::optional<std::string> map_id_;  // none while none is known
  std::uint64_t heard_ = 0;            // the last revision from the topic
  std::uint64_t revision_ = 0;         // of the last batch that was passed on
  bool exact_ = true;                  // nothing up to that is missing
  std::uint64_t base_ = 0;             // the last revision of which nothing was missing
  bool pulling_ = false;
  std::uint64_t round_ = 0;      // revision of the first answer of this pull
  std::uint32_t block_ = 0;      // to go on with
  int rounds_ = 0;               // that this pull has begun
  std::uint64_t ended_at_ = 0;   // revision of the last answer of a round, 0 in its course
  std::uint64_t number_ = 0;     // of the last request
  std::optional<double> asked_;  // when it was sent, if it wasn't answered [s]
  bool refused_ = false;         // by a server that has no such map
  bool answered_ = false;        // who seemed not to be there
  double patience_ = kPatience;
  double ask_from_ = kNever, retry_from_ = kNever, blind_from_ = kNever, check_from_ = kNever;
  std::deque<Labelled> waiting_;
  std::size_t waiting_bytes_ = 0;
};

}  // namespace rosplat
