// Thread pool for numbered pieces of work. The result of a piece must not depend on the thread that does it.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <condition_variable>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace cicatrix {

class Pool {
   public:
    // tiles_per_piece: smallest piece of work, below which another thread does not pay off.
    Pool(int threads, int64_t tiles_per_piece) : tiles_per_piece_(static_cast<size_t>(tiles_per_piece)) {
        try {
            for (int i = 1; i < threads; ++i) workers_.emplace_back([this] { work(); });
        } catch (...) {
            stop();
            throw;
        }
    }

    ~Pool() { stop(); }

    Pool(const Pool&) = delete;
    Pool& operator=(const Pool&) = delete;

    int threads() const { return static_cast<int>(workers_.size()) + 1; }
    size_t tiles_per_piece() const { return tiles_per_piece_; }
    int most_pieces() const { return 4 * threads(); }

    // Number of pieces into which n tiles are divided.
    int pieces(size_t n) const {
        if (threads() == 1) return 1;
        return static_cast<int>(std::clamp<size_t>(n / tiles_per_piece_, 1, most_pieces()));
    }

    // Call each of job(0) .. job(n - 1) once and wait for all; rethrow the first exception.
    template <class Job>
    void each(int n, Job&& job) {
        if (workers_.empty() || n < 2) {
            for (int i = 0; i < n; ++i) job(i);
            return;
        }
        const std::function<void(int)> call = std::ref(job);
        {
            std::lock_guard<std::mutex> lock(mutex_);
            job_ = &call, n_ = n, busy_ = static_cast<int>(workers_.size()), error_ = nullptr;
            next_.store(0);
            round_.fetch_add(1);
        }
        wake_.notify_all();
        share();
        for (int spin = 0; spin < kSpins && busy_.load() > 0; ++spin) std::this_thread::yield();
        std::unique_lock<std::mutex> lock(mutex_);
        done_.wait(lock, [this] { return busy_.load() == 0; });
        if (error_) std::rethrow_exception(error_);
    }

   private:
    static constexpr int kSpins = 2000;  // pieces are short, so going to sleep would take longer than a piece

    void stop() {
        {
            std::lock_guard<std::mutex> lock(mutex_);
            stop_ = true;
        }
        wake_.notify_all();
        for (auto& worker : workers_) worker.join();
    }

    void share() {
        for (int i = next_.fetch_add(1); i < n_; i = next_.fetch_add(1)) {
            try {
                (*job_)(i);
            } catch (...) {
                std::lock_guard<std::mutex> lock(mutex_);
                if (!error_) error_ = std::current_exception();
            }
        }
    }

    void work() {
        unsigned seen = 0;
        while (true) {
            for (int spin = 0; spin < kSpins && round_.load() == seen && !stop_.load(); ++spin) std::this_thread::yield();
            {
                std::unique_lock<std::mutex> lock(mutex_);
                wake_.wait(lock, [&] { return stop_.load() || round_.load() != seen; });
                if (stop_.load()) return;
                seen = round_.load();
            }
            share();
            std::lock_guard<std::mutex> lock(mutex_);
            if (busy_.fetch_sub(1) == 1) done_.notify_one();
        }
    }

    const size_t tiles_per_piece_;
    std::vector<std::thread> workers_;
    std::mutex mutex_;
    std::condition_variable wake_, done_;
    const std::function<void(int)>* job_ = nullptr;
    int n_ = 0;
    std::atomic<int> next_{0}, busy_{0};
    std::atomic<unsigned> round_{0};
    std::atomic<bool> stop_{false};
    std::exception_ptr error_;
};

}  // namespace cicatrix
