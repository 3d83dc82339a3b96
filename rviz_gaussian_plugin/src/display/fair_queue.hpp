#pragma once

#include <algorithm>
#include <cstddef>
#include <deque>
#include <optional>
#include <utility>

namespace rosplat {

// A bounded number of waiting requests. Clients are served in turn, however many each has sent.
template <typename Client, typename Request>
class FairQueue {
 public:
  explicit FairQueue(std::size_t most) : most_(most) {}

  // Returns the request that finds no room, if any: the newest of the client with the most waiting.
  std::optional<Request> push(const Client& client, Request request) {
    auto own = std::find_if(clients_.begin(), clients_.end(),
                            [&](const Waiting& waiting) { return waiting.client == client; });
    if (own == clients_.end()) own = clients_.insert(own, Waiting{client, {}});
    own->requests.push_back(std::move(request));
    if (++size_ <= most_) return std::nullopt;
    // Of clients with equally many requests, the one whose turn comes last.
    const auto greediest =
        std::prev(std::max_element(clients_.rbegin(), clients_.rend(),
                                   [](const Waiting& a, const Waiting& b) {
                                     return a.requests.size() < b.requests.size();
                                   })
                      .base());
    Request refused = std::move(greediest->requests.back());
    greediest->requests.pop_back();
    if (greediest->requests.empty()) clients_.erase(greediest);
    --size_;
    return refused;
  }

  // The oldest request of the client whose turn it is.
  std::optional<Request> pop() {
    if (clients_.empty()) return std::nullopt;
    Waiting next = std::move(clients_.front());
    clients_.pop_front();
    Request request = std::move(next.requests.front());
    next.requests.pop_front();
    if (!next.requests.empty()) clients_.push_back(std::move(next));
    --size_;
    return request;
  }

  bool empty() const { return clients_.empty(); }

 private:
  struct Waiting {
    Client client;
    std::deque<Request> requests;  // never empty, oldest first
  };

  std::size_t most_;
  std::size_t size_ = 0;         // requests of all clients
  std::deque<Waiting> clients_;  // the next to be served first
};

}  // namespace rosplat
