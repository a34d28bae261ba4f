#pragma once

// Values by key, bounded by the bytes they hold: the least recently used make room. Not thread-safe.

#include <cstdint>
#include <list>
#include <map>
#include <utility>
#include <vector>

namespace barycast {

// Value: a pointer; null stands for none.
template <class Key, class Value>
class BoundedLru {
 public:
  explicit BoundedLru(uint64_t bytes_max) : bytes_max_(bytes_max) {}

  // Counts as a use.
  Value find(const Key& key) {
    const auto found = by_key_.find(key);
    if (found == by_key_.end()) return nullptr;
    entries_.splice(entries_.begin(), entries_, found->second);
    return found->second->value;
  }

  // Keeps a value unless it is larger than the bound, or its key is held already. What made room goes to `evicted`, to
  // be destroyed where the caller likes.
  void keep(const Key& key, Value value, uint64_t bytes, std::vector<Value>& evicted) {
    if (bytes > bytes_max_ || by_key_.contains(key)) return;
    const auto at = by_key_.try_emplace(key, entries_.end()).first;
    try {
      entries_.push_front({key, std::move(value), bytes});
    } catch (...) {
      by_key_.erase(at);
      throw;
    }
    at->second = entries_.begin();
    bytes_ += bytes;
    make_room(evicted);
  }

  // Where a value that is held has grown, by itself or another.
  void resize(const Key& key, uint64_t bytes, std::vector<Value>& evicted) {
    const auto found = by_key_.find(key);
    if (found == by_key_.end()) return;
    bytes_ += bytes - found->second->bytes;
    found->second->bytes = bytes;
    // What is larger than the bound must not push out all the others.
    if (bytes > bytes_max_) entries_.splice(entries_.end(), entries_, found->second);
    make_room(evicted);
  }

  uint64_t bytes() const { return bytes_; }
  size_t size() const { return entries_.size(); }

 private:
  struct Entry {
    Key key;
    Value value;
    uint64_t bytes;
  };

  void make_room(std::vector<Value>& evicted) {
    while (bytes_ > bytes_max_) {
      Entry& last = entries_.back();
      bytes_ -= last.bytes;
      by_key_.erase(last.key);
      evicted.push_back(std::move(last.value));
      entries_.pop_back();
    }
  }

  uint64_t bytes_max_;
  uint64_t bytes_ = 0;
  std::list<Entry> entries_;  // most recently used first
  std::map<Key, typename std::list<Entry>::iterator> by_key_;
};

}  // namespace barycast
