#pragma once

// What barycast_bind shows: a bar while it works, and a short account of the result.

#include <string>

#include "barycast/client/binding.h"
#include "barycast/client/client.h"

namespace barycast::program {

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
