#pragma once

#include <algorithm>
#include <cmath>
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

// How long to wait for an answer before the question is asked again: TCP's retransmission timer
// (RFC 6298). It follows what answers take, their mean and four mean deviations, and doubles with
// each question in vain, until an answer comes. [s]
class Patience {
 public:
  static constexpr double kAtFirst = 2.0;  // while no answer is known
  static constexpr double kLeast = 1.0;
  static constexpr double kMost = 8.0;  // by doubling alone

  double wait() const { return wait_; }

  void learn(double took) {
    if (mean_) {
      deviation_ += (std::abs(took - *mean_) - deviation_) / 4;
      *mean_ += (took - *mean_) / 8;
    } else {
      mean_ = took;
      deviation_ = took / 2;
    }
    usual_ = std::max(kLeast, *mean_ + 4 * deviation_);
    wait_ = usual_;
  }

  void doubleUp() { wait_ = std::min(2 * wait_, std::max(kMost, usual_)); }

 private:
  std::optional<double> mean_;
  double deviation_ = 0;
  double usual_ = kAtFirst, wait_ = kAtFirst;
};

// Decides what a receiver of a map asks its publisher for, and when, until the receiver lacks
// nothing. The class follows the batches of a map, which may be of any type, by their labels. All
// times are of one monotonic clock [s].
//
// A pull consists of rounds. A round asks for the map block by block; each answer holds some blocks
// as they are at that moment. The map changes meanwhile, and batches that are heard wait. Once all
// blocks have come, the round ends. A pull ends with a round
// - in which the map did not change, or
// - whose changes all wait: applied in turn, they turn the map into that of the last answer.
// Otherwise another round asks for what has changed since this one began. After a pull, the map is
// that of one revision, and the batches above that revision follow. Where nothing can be pulled,
// batches are applied as they come.
//
// An answer may be slow or get lost. The block is asked for again once its patience ends, and the
// first answer to any of these requests counts. After kMostLate requests in vain, batches no longer
// wait. What has come is kept: the round goes on at its block as soon as an answer comes.
//
// A receiver that knows no map asks for any. It asks now and then even if no server is known:
// discovery reports a server late, and none while it knows only a part of one. A receiver that
// hears nothing for a while asks whether it has everything: the last batch may be lost.
//
// Where nobody answers, the publishers' history may have what is missing. So the receiver
// subscribes anew, once, and takes of the history what follows the last revision that it has all
// of.
//
// Where a server is known and nothing has ever come, the middleware may have lost the way to this
// process: Fast DDS does in shared memory, after a process that hung was killed and this one has
// got its port (eProsima/Fast-DDS#5469). So the receiver joins the network anew, once, by another
// participant.
template <typename Batch>
class MapPull {
 public:
  // Pause from the start of a round to that of the next, and after an answer below kSmall. [s]
  static constexpr double kPause = 0.1;
  static constexpr std::size_t kSmall = 1u << 14;  // [bytes]
  static constexpr int kMostRounds = 32;           // after more, a pull is given up
  static constexpr int kMostLate = 3;              // requests in vain until batches no longer wait
  static constexpr std::size_t kMostSent = 16;     // requests for one block whose answers count
  static constexpr double kOthers = 0.5;  // time for other servers once one lacks the map [s]
  static constexpr double kRetry = 1.0;   // pause after a pull that was given up [s]
  // Time from one request to the next while no server is known. [s]
  static constexpr double kBlind = 2.0;
  // Time from the last batch or request until the receiver asks whether a batch got lost. [s]
  static constexpr double kQuiet = 2.0;
  // Time from a server's first sign until a receiver that nothing reaches joins anew. [s]
  static constexpr double kDeaf = 12.0;
  // Time for the next batch of a history. [s]
  static constexpr double kHistory = 5.0;
  // The most that waits for the end of a pull. [bytes]
  static constexpr std::size_t kMostWaiting = std::size_t(1) << 26;
  static constexpr std::uint32_t kBlocks = 1u << 15;  // of slots, in a map

  // What the class needs to know of a batch.
  struct Label {
    std::string map_id;
    std::uint64_t revision = 0;
    bool replaces = false;  // a REPLACE
    std::size_t bytes = 0;
  };
  struct Labelled {
    Label label;
    Batch batch;
  };
  // A request of PullMap.srv. Its number goes to answer() with each of its answers.
  struct Request {
    std::uint64_t number = 0;
    std::string map_id;
    std::uint64_t after_revision = 0;
    std::uint32_t first_block = 0;
  };
  // What the caller has to do now: apply batches in turn, send a request, subscribe anew if the
  // subscription is transient local, and join the network anew.
  struct Step {
    std::vector<std::pair<Batch, Arrival>> batches;
    std::optional<Request> request;
    bool subscribe_anew = false;
    bool join_anew = false;
  };

  // Takes a batch from the topic. served: whether a server is known.
  Step receive(Labelled heard, double now, bool served) {
    Step step;
    const Label& label = heard.label;
    reached_ = true;
    if (label.revision == 0) {  // will be refused
      step.batches.emplace_back(std::move(heard.batch), Arrival::kHeard);
      return step;
    }
    if (repeats(label, now)) {
      // The batch that was heard last ends it: the next one begins anew, as of a bag in a loop.
      history_until_ = label.revision == heard_ ? kNever : now + kHistory;
      followHistory(std::move(heard), step);
      return step;
    }
    note(label, served);
    check_from_ = now + kQuiet;
    follow(std::move(heard), now, served || answered_, step);
    ask(now, served, step);
    return step;
  }

  // Takes the label of a batch from the topic that there was no room for: it is pulled later, since
  // a server is known.
  void miss(const Label& label, double now) {
    reached_ = true;
    if (label.revision == 0 || repeats(label, now)) return;
    note(label, true);
    exact_ = false;
  }

  // The caller has subscribed anew: the publishers' history comes, heard before or not.
  void subscribedAnew(double now) { history_until_ = now + kHistory; }

  // The caller had no memory for a batch that it was to apply, and applied none after it: all of
  // the map is pulled, after a while.
  void restart(double now) {
    stop();
    exact_ = false;
    base_ = 0;
    retry_from_ = now + kRetry;
  }

  // Whether an answer to a request still counts: none has come to it, or to one for the same block.
  bool awaits(std::uint64_t number) const {
    return number <= number_ && number_ - number < sent_.size();
  }

  // Takes an answer to a request; several servers may send one each. It counts if it is awaited,
  // and none after the first that has batches.
  Step answer(std::uint64_t number, std::vector<Labelled> batches, std::uint32_t next_block,
              double now, bool served) {
    Step step;
    reached_ = true;
    if (!awaits(number)) return step;
    if (batches.empty()) {  // this server lacks the map; another may have it
      if (!refused_from_) refused_from_ = now;
      return step;
    }
    const Label first = batches.front().label;
    patience_.learn(now - sent_[sent_.size() - 1 - (number_ - number)]);
    if (std::exchange(gone_, false) && first.map_id != map_id_) {
      stop();
      begin(first.map_id);
    }
    if (!lacks() && !pulling_ && first.map_id == *map_id_ && first.revision <= revision_) {
      forget();
      return step;  // nothing got lost
    }
    const bool begun_anew = first.replaces && base_ > 0;  // under the same name
    if (first.map_id == map_id_ && !begun_anew && first.revision > 0 &&
        first.revision < revision_) {
      // What was heard has overtaken the answer. Batches have to wait for the next one.
      if (std::exchange(silent_, false)) pull();
      ask(now, served, step);
      return step;
    }
    forget();
    if (!isSound(batches, next_block)) {
      giveUp(now, step);
      return step;
    }
    ended_at_ = 0;
    pulling_ = answered_ = true;
    silent_ = false;
    late_ = 0;
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

  // Handles overdue answers and asks anew; to be called several times a second.
  Step tick(double now, bool served) {
    Step step;
    const bool refused = refused_from_ && now > *refused_from_ + kOthers;
    const bool late = asked_ && (refused || now > sent_.back() + patience_.wait());
    if (late) {
      asked_ = false;
      ++late_;
      gone_ = refused_from_ && !pulling_;
      if (served && !refused_from_) patience_.doubleUp();
    }
    if (pulling_ && ((late && (refused_from_ || late_ >= kMostLate)) || !(served || answered_))) {
      pause(now, step);
    }
    if (late && !served && lacks() && map_id_ && !pulling_ && !silent_ && !searched_) {
      step.subscribe_anew = searched_ = true;
    }
    if (served && !reached_) {
      if (!deaf_from_) deaf_from_ = now + kDeaf;
      step.join_anew = reached_ = now >= *deaf_from_;
    }
    if (step.join_anew) {  // the new participant knows no server yet
      asked_ = pulling_ = silent_ = false;
      retry_from_ = now + kBlind;
    }
    ask(now, served, step);
    return step;
  }

  // Whether a pull is in progress.
  bool pulling() const { return pulling_; }

  bool held = false;  // set by the caller: send no request, there is no room for answers

 private:
  static constexpr double kNever = -std::numeric_limits<double>::infinity();

  void note(const Label& label, bool served) {
    gone_ = false;
    if (label.map_id != map_id_) {
      if (map_id_) stop();
      begin(label.map_id);
    }
    const bool again = label.revision <= heard_;
    heard_ = label.revision;
    if (!again) return;
    stop();
    exact_ = label.replaces;
    // A publisher that was lost and found, perhaps: its server says what has changed since base_.
    if (served && !label.replaces) return;
    revision_ = label.revision - 1;  // a bag plays the map again
    base_ = 0;
  }

  // Keeps what is asked: the answer to a request without a map_id may be of this map.
  void begin(const std::string& map_id) {
    map_id_ = map_id;
    patience_ = {};
    heard_ = revision_ = base_ = 0;
    exact_ = true;  // nothing is missing of an empty map
    searched_ = false;
    retry_from_ = kNever;
  }

  void stop() {
    forget();
    pulling_ = silent_ = false;
    late_ = 0;
    block_ = 0;
    rounds_ = 0;
    ended_at_ = 0;
    waiting_.clear();
    waiting_bytes_ = 0;
  }

  // Answers to what was asked don't count any more.
  void forget() {
    asked_ = false;
    refused_from_.reset();
    sent_.clear();
  }

  void follow(Labelled heard, double now, bool served, Step& step) {
    const Label& label = heard.label;
    if (pulling_ && !label.replaces) {
      if (label.revision > round_) wait(std::move(heard));
      finish(now, step);
      return;
    }
    if (label.revision <= revision_) return;  // the pull has brought it already
    if (label.replaces) {
      stop();
      exact_ = true;
      searched_ = false;
    } else if (label.revision - revision_ > 1) {
      if (served && !silent_ && now >= retry_from_) {
        pull();
        return wait(std::move(heard));
      }
      exact_ = false;
    }
    revision_ = label.revision;
    if (exact_) base_ = label.revision;
    step.batches.emplace_back(std::move(heard.batch), Arrival::kHeard);
  }

  // Whether a batch is of the history, and not of a map that begins anew.
  bool repeats(const Label& label, double now) const {
    const bool known = label.map_id == map_id_ && label.revision <= heard_;
    return now < history_until_ && known && !(label.replaces && lacks());
  }

  // Takes a batch of the history: if it is the next one, it and those that follow were missing.
  void followHistory(Labelled heard, Step& step) {
    const std::uint64_t revision = heard.label.revision;
    if (exact_ || pulling_ || silent_ || revision != base_ + 1) return;
    base_ = revision;
    exact_ = base_ >= revision_;
    if (exact_) searched_ = false;
    step.batches.emplace_back(std::move(heard.batch), exact_ ? Arrival::kLast : Arrival::kPulled);
  }

  void pull() {
    pulling_ = true;
    if (block_ == 0) round_ = revision_;
    asked_ = false;  // a request to no known server may be lost
    late_ = 0;
  }

  void wait(Labelled heard) {
    waiting_bytes_ += heard.label.bytes;
    waiting_.push_back(std::move(heard));
    // Drops the oldest. This leaves a gap, which is pulled.
    while (waiting_bytes_ > kMostWaiting && waiting_.size() > 1) dropFirst();
  }

  void dropFirst() {
    waiting_bytes_ -= waiting_.front().label.bytes;
    waiting_.pop_front();
  }

  // Ends the pull if a round has ended and all changes during that round wait. Returns whether.
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

  // Ends a pull that left nothing missing, and follows the batches that waited.
  void goOn(double now, Step& step) {
    std::deque<Labelled> waiting = std::move(waiting_);
    stop();
    exact_ = true;
    for (Labelled& heard : waiting) follow(std::move(heard), now, true, step);
    if (revision_ < heard_ && !pulling_) exact_ = false;  // miss() got the last batch
  }

  // Nobody answers: batches no longer wait. The round goes on with the next answer.
  void pause(double now, Step& step) {
    pulling_ = false;
    silent_ = true;
    passOn(now, step);
  }

  // The answers made no sense, or don't end: the pull begins again, later.
  void giveUp(double now, Step& step) {
    std::deque<Labelled> waiting = std::move(waiting_);
    stop();
    waiting_ = std::move(waiting);
    passOn(now, step);
  }

  // Passes on the batches that wait, though something before them is missing.
  void passOn(double now, Step& step) {
    exact_ = answered_ = false;
    ended_at_ = 0;
    retry_from_ = now + kRetry;
    waiting_bytes_ = 0;
    for (Labelled& heard : std::exchange(waiting_, {})) follow(std::move(heard), now, false, step);
  }

  void ask(double now, bool served, Step& step) {
    if (lacks() && !silent_ && (served || answered_) && now >= retry_from_ && !pulling_) pull();
    const bool blind = lacks() && !pulling_ && now >= std::max(blind_from_, retry_from_);
    const bool checks = !lacks() && !pulling_ && served && now >= check_from_;
    if (held || asked_ || !(blind || checks || (pulling_ && now >= ask_from_))) return;
    if (block_ == 0) ask_from_ = now + kPause;
    check_from_ = now + kQuiet;
    blind_from_ = now + kBlind;
    asked_ = true;
    refused_from_.reset();
    sent_.push_back(now);
    if (sent_.size() > kMostSent) sent_.pop_front();
    if (gone_) {
      step.request = Request{++number_, "", 0, 0};
    } else {
      step.request = Request{++number_, map_id_.value_or(""), base_, block_};
    }
  }

  bool lacks() const { return !exact_ || !map_id_; }

  bool isSound(const std::vector<Labelled>& batches, std::uint32_t next_block) const {
    const Label& first = batches.front().label;
    if (first.revision == 0) return false;
    const std::uint32_t block = first.replaces ? 0 : block_;
    if (next_block != 0 && (next_block <= block || next_block >= kBlocks)) return false;
    const std::string& map_id = map_id_ ? *map_id_ : first.map_id;
    return std::all_of(batches.begin(), batches.end(), [&](const Labelled& each) {
      return each.label.map_id == map_id && each.label.revision == first.revision;
    });
  }

  std::optional<std::string> map_id_;  // none while none is known
  std::uint64_t heard_ = 0;            // of the last batch from the topic
  std::uint64_t revision_ = 0;         // of the last batch that was passed on
  bool exact_ = true;                  // nothing up to revision_ is missing
  std::uint64_t base_ = 0;             // the last revision up to which nothing was missing
  bool pulling_ = false;
  std::uint64_t round_ = 0;     // revision of the first answer of this round
  std::uint32_t block_ = 0;     // to ask for next; 0: a new round
  int rounds_ = 0;              // that this pull has begun
  std::uint64_t ended_at_ = 0;  // revision of the last answer of a round, 0 until it ends
  std::uint64_t number_ = 0;    // of the last request
  std::deque<double>
      sent_;             // when the requests were sent whose answers count, the last is number_ [s]
  bool asked_ = false;   // the last of them has some time left
  int late_ = 0;         // requests of this pull in vain, since its last answer
  bool silent_ = false;  // the pull is paused: nobody answers
  bool gone_ = false;    // no server has the map any more: any other is asked for
  std::optional<double> refused_from_;  // when a server answered that it lacks the map [s]
  bool answered_ = false;               // a server answers, even if none is known
  Patience patience_;
  bool reached_ = false;  // something has come, or the receiver has joined anew
  std::optional<double> deaf_from_;
  bool searched_ = false;  // the history of this map, for what is missing
  double history_until_ = kNever;
  double ask_from_ = kNever, retry_from_ = kNever, blind_from_ = kNever, check_from_ = kNever;
  std::deque<Labelled> waiting_;
  std::size_t waiting_bytes_ = 0;
};

}  // namespace rosplat
