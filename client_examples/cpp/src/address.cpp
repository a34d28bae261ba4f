#include <algorithm>
#include <string_view>

#include "barycast/client/client.h"

namespace barycast::client {
namespace {

constexpr uint32_t kPortMax = 65535;

bool is_port(std::string_view text) {
  if (text.empty() || text.size() > 5 || text.find_first_not_of("0123456789") != text.npos) return false;
  const auto port = static_cast<uint32_t>(std::stoul(std::string(text)));
  return port >= 1 && port <= kPortMax;
}

bool bracketed(std::string_view host) {
  return (host.starts_with('[') && host.ends_with(']')) || (host.starts_with("%5B") && host.ends_with("%5D"));
}

bool is_host_port(std::string_view text) {
  const size_t colon = text.rfind(':');
  if (colon == text.npos || colon == 0 || !is_port(text.substr(colon + 1))) return false;
  const std::string_view host = text.substr(0, colon);
  if (host.find_first_of("/ \t\r\n") != host.npos) return false;
  return host.find(':') == host.npos || bracketed(host);
}

bool is_list(std::string_view text) {
  for (;;) {
    const size_t comma = std::min(text.find(','), text.size());
    if (!is_host_port(text.substr(0, comma))) return false;
    if (comma == text.size()) return true;
    text.remove_prefix(comma + 1);
  }
}

bool is_address(std::string_view text) {
  for (const std::string_view scheme : {"unix:", "unix-abstract:", "vsock:", "xds:"}) {
    if (text.starts_with(scheme)) return text.size() > scheme.size();
  }
  for (const std::string_view scheme : {"dns:", "ipv4:", "ipv6:"}) {
    if (!text.starts_with(scheme)) continue;
    text.remove_prefix(scheme.size());
    if (text.starts_with("//")) text.remove_prefix(std::min(text.find('/', 2), text.size() - 1) + 1);  // an authority
    return scheme == "dns:" ? is_host_port(text) : is_list(text);
  }
  return is_host_port(text);
}

}  // namespace

Status check_address(const std::string& address) {
  if (is_address(address)) return Done{};
  return input_error("server", "\"" + address +
                                   "\" is no address; give HOST:PORT or [::1]:PORT with a port from 1 to 65535, "
                                   "unix:PATH, or dns:///HOST:PORT");
}

}  // namespace barycast::client
