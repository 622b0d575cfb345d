// A small pool of threads for loops whose iterations are independent.
#pragma once
#include <atomic>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace lodpipe {

class Pool {
 public:
  explicit Pool(int threads) {
    for (int i = 1; i < threads; ++i) workers_.emplace_back([this] { work(); });
  }
  ~Pool() {
    {
      std::lock_guard lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    for (auto& w : workers_) w.join();
  }
  Pool(const Pool&) = delete;
  Pool& operator=(const Pool&) = delete;

  int threads() const { return static_cast<int>(workers_.size()) + 1; }

  // Calls body(i) once for each i in [0, count), in any order and on any thread.
  void run(int count, const std::function<void(int)>& body) {
    if (workers_.empty() || count < 2) {
      for (int i = 0; i < count; ++i) body(i);
      return;
    }
    {
      std::lock_guard lock(mutex_);
      body_ = &body;
      count_ = count;
      next_ = 0;
      busy_ = static_cast<int>(workers_.size());
      ++generation_;
    }
    wake_.notify_all();
    drain();
    std::unique_lock lock(mutex_);
    done_.wait(lock, [this] { return busy_ == 0; });
  }

  // Calls body(begin, end) for pieces of [0, size) of about `grain` items.
  template <class Body>
  void range(int size, int grain, const Body& body) {
    if (size <= 0) return;
    const int pieces = (size + grain - 1) / grain;
    run(pieces, [&](int i) {
      const int begin = i * grain;
      body(begin, size - begin < grain ? size : begin + grain);
    });
  }

 private:
  void drain() {
    for (int i; (i = next_.fetch_add(1)) < count_;) (*body_)(i);
  }
  void work() {
    int seen = 0;
    for (;;) {
      {
        std::unique_lock lock(mutex_);
        wake_.wait(lock, [&] { return stop_ || generation_ != seen; });
        if (stop_) return;
        seen = generation_;
      }
      drain();
      std::lock_guard lock(mutex_);
      if (--busy_ == 0) done_.notify_one();
    }
  }

  std::vector<std::thread> workers_;
  std::mutex mutex_;
  std::condition_variable wake_, done_;
  const std::function<void(int)>* body_ = nullptr;
  std::atomic<int> next_{0};
  int count_ = 0, busy_ = 0, generation_ = 0;
  bool stop_ = false;
};

}  // namespace lodpipe
