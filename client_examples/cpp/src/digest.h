#pragma once

// The canonical bytes of a cage, as barycast/v1/cage.proto defines them, and their SHA-256.

#include "barycast/client/cage.h"

namespace barycast::client {

// Of parts that Cage::create has checked.
CageDigest digest_of(const CageParts& parts);

}  // namespace barycast::client
