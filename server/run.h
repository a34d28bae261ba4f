#pragma once

// The program after the check of the processor: command line, probe or serve, signals, exit code.

namespace barycast::server {

// 0: done. 1: it could not serve, or the probe found no serving server. Others: a wrong command line.
int run(int argc, char** argv);

}  // namespace barycast::server
