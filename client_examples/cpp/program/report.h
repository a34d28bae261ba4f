#pragma once

// What barycast_bind shows: a bar while it works, and a short account of the result.

#include <string>
#include <thread>

#include "arguments.h"
#include "barycast/client/binding.h"
#include "barycast/client/client.h"

namespace barycast::program {

// While a server that was named does not answer for a while, says so once, on standard error, where that is a terminal.
class WaitingLine {
 public:
  // Both must outlive it.
  WaitingLine(const client::Client& client, const Arguments& arguments);

 private:
  std::jthread watcher_;
};

// Draws on standard error, where that is a terminal, and takes the line away when it is destroyed.
class ProgressBar {
 public:
  explicit ProgressBar(bool quiet);
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;
  ~ProgressBar();

  void show(const client::Progress& progress);

 private:
  bool visible_;
  bool drawn_ = false;
};

// Lines for people, as the Python command line shows them.
std::string summary(const client::Binding& binding);

}  // namespace barycast::program
