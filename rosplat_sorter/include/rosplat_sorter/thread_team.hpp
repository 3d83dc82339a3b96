#ifndef ROSPLAT_SORTER__THREAD_TEAM_HPP_
#define ROSPLAT_SORTER__THREAD_TEAM_HPP_

#include <algorithm>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace rosplat_sorter {

// Threads that wait for work between the short parallel steps of a sort. They begin when there is
// some first; callers take turns.
class ThreadTeam {
 public:
  // threads counts the caller's own; 0 takes as many as the machine runs at once.
  explicit ThreadTeam(unsigned threads) : size_(threads > 0 ? threads : machine()) {}

  // The team of all who draw in a process, while any of them has it. A core stays theirs, but of
  // two, sorting gains more than drawing loses.
  static std::shared_ptr<ThreadTeam> ofViewers() {
    constexpr unsigned kMost = 16;  // measured up to there
    static std::mutex mutex;
    static std::weak_ptr<ThreadTeam> team;
    const std::lock_guard<std::mutex> lock(mutex);
    std::shared_ptr<ThreadTeam> shared = team.lock();
    if (!shared) {
      const unsigned cores = machine();
      shared = std::make_shared<ThreadTeam>(std::min(cores > 2 ? cores - 1 : cores, kMost));
      team = shared;
    }
    return shared;
  }

  ~ThreadTeam() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      stopping_ = true;
    }
    wake_.notify_all();
    for (std::thread& worker : workers_) worker.join();
  }

  ThreadTeam(const ThreadTeam&) = delete;
  ThreadTeam& operator=(const ThreadTeam&) = delete;

  unsigned size() const { return size_; }

  // Runs task(0) ... task(members - 1) at once, task(0) in the caller, and returns when all are
  // done. members <= size(); the task must not throw.
  void run(unsigned members, const std::function<void(unsigned)>& task) {
    if (members < 2) return task(0);
    const std::lock_guard<std::mutex> turn(callers_);
    const unsigned helped = begin(members);
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      task_ = &task;
      members_ = helped;
      running_ = helped - 1;
      ++round_;
      wake_.notify_all();
    }
    task(0);
    for (unsigned member = helped; member < members; ++member) task(member);
    std::unique_lock<std::mutex> lock(mutex_);
    done_.wait(lock, [this] { return running_ == 0; });
  }

 private:
  static unsigned machine() { return std::max(1u, std::thread::hardware_concurrency()); }

  // Sees to it that there are so many, the caller included, or as many as the system lets be.
  unsigned begin(unsigned members) {
    try {
      while (workers_.size() + 1 < members) {
        const auto member = static_cast<unsigned>(workers_.size()) + 1;
        workers_.emplace_back([this, member, seen = round_] { work(member, seen); });
      }
    } catch (const std::system_error&) {
    }
    return std::min(members, static_cast<unsigned>(workers_.size()) + 1);
  }

  void work(unsigned member, std::uint64_t seen) {
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
      wake_.wait(lock, [&] { return stopping_ || round_ != seen; });
      if (stopping_) return;
      seen = round_;
      if (member >= members_) continue;
      const std::function<void(unsigned)>& task = *task_;
      lock.unlock();
      task(member);
      lock.lock();
      if (--running_ == 0) done_.notify_one();
    }
  }

  const unsigned size_;
  std::mutex callers_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::condition_variable done_;
  const std::function<void(unsigned)>* task_ = nullptr;
  unsigned members_ = 0;
  unsigned running_ = 0;
  std::uint64_t round_ = 0;
  bool stopping_ = false;
  std::vector<std::thread> workers_;
};

}  // namespace rosplat_sorter

#endif  // ROSPLAT_SORTER__THREAD_TEAM_HPP_
