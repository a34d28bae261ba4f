// barycastd: the daemon. That the processor is new enough was checked before this, in processor.cpp.

#include "run.h"

int main(int argc, char** argv) {
  return barycast::server::run(argc, argv);
}
