#ifndef ROSPLAT_SORTER__THREAD_TEAM_HPP_
#define ROSPLAT_SORTER__THREAD_TEAM_HPP_

#include <algorithm>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

namespace rosplat_sorter {

// Threads that wait for work between the short parallel steps of a sort. One caller at a time.
class ThreadTeam {
 public:
  // threads counts the caller's own; 0 takes as many as the machine runs at once.
  explicit ThreadTeam(unsigned threads) {
    if (threads == 0) threads = std::max(1u, std::thread::hardware_concurrency());
    for (unsigned member = 1; member < threads; ++member) {
      workers_.emplace_back([this, member] { work(member); });
    }
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

  unsigned size() const { return static_cast<unsigned>(workers_.size()) + 1; }

  // Runs task(0) ... task(members - 1) at once, task(0) in the caller, and returns when all are
  // done. members <= size(); the task must not throw.
  void run(unsigned members, const std::function<void(unsigned)>& task) {
    if (members > 1) {
      const std::lock_guard<std::mutex> lock(mutex_);
      task_ = &task;
      members_ = members;
      running_ = members - 1;
      ++round_;
      wake_.notify_all();
    }
    task(0);
    if (members > 1) {
      std::unique_lock<std::mutex> lock(mutex_);
      done_.wait(lock, [this] { return running_ == 0; });
    }
  }

 private:
  void work(unsigned member) {
    std::uint64_t seen = 0;
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
