#pragma once

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <new>
#include <system_error>
#include <thread>
#include <vector>

namespace rosplat {

// Threads that wait for work between the short parallel steps of a sort. A thread starts when it is
// first needed. Callers take turns.
class ThreadTeam {
 public:
  // threads counts the caller's own; 0 takes as many as the machine runs at once.
  explicit ThreadTeam(unsigned threads) : size_(threads > 0 ? threads : machine()) {}

  // The team that all viewers of a process share; lives while any viewer holds it. It leaves a core
  // to drawing, unless there are only two: there, sorting gains more than drawing loses.
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

  // Calls task(number, member) for each number below count, in parallel, and returns when all are
  // done. member: the thread that runs the task, 0 is the caller's. A thread that wakes late leaves
  // more to the others. The task must not throw.
  void run(unsigned count, const std::function<void(unsigned, unsigned)>& task) {
    const std::lock_guard<std::mutex> turn(callers_);
    begin(std::min(count, size_));
    std::unique_lock<std::mutex> lock(mutex_);
    task_ = &task;
    count_ = count;
    next_ = 0;
    if (count > 1) wake_.notify_all();
    work(0, lock);
    done_.wait(lock, [this] { return working_ == 0; });
  }

 private:
  static unsigned machine() { return std::max(1u, std::thread::hardware_concurrency()); }

  // Starts threads until there are so many members, the caller included, or the system refuses.
  void begin(unsigned members) {
    try {
      while (workers_.size() + 1 < members) {
        const auto member = static_cast<unsigned>(workers_.size()) + 1;
        workers_.emplace_back([this, member] {
          std::unique_lock<std::mutex> lock(mutex_);
          while (!stopping_) {
            work(member, lock);
            wake_.wait(lock, [this] { return stopping_ || next_ < count_; });
          }
        });
      }
    } catch (const std::system_error&) {
    } catch (const std::bad_alloc&) {
    }
  }

  // Runs tasks that no member has begun, until none is left. Releases the lock meanwhile: nobody
  // changes the task or the count while members work.
  void work(unsigned member, std::unique_lock<std::mutex>& lock) {
    if (next_ >= count_) return;
    ++working_;
    lock.unlock();
    for (unsigned number; (number = next_++) < count_;) (*task_)(number, member);
    lock.lock();
    if (--working_ == 0) done_.notify_one();
  }

  const unsigned size_;
  std::mutex callers_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::condition_variable done_;
  const std::function<void(unsigned, unsigned)>* task_ = nullptr;
  unsigned count_ = 0;
  std::atomic<unsigned> next_{0};  // the first number that no member has begun
  unsigned working_ = 0;           // members
  bool stopping_ = false;
  std::vector<std::thread> workers_;
};

}  // namespace rosplat
