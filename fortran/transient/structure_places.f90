!> The motion of a structure at fixed positions in a step, for event detection, by matrices that
!! are built once for each step length.
!!
!! The observed coordinates (`viscovib_structure_inside`) at a position of a step are linear in the
!! state at its start, in the forces at its nodes and in the sines and cosines of the load phases
!! there. Each part of the step has one matrix for all its positions.
module viscovib_structure_places
  use viscovib_collocation, only: collocation_type
  use viscovib_kinds, only: wp
  use viscovib_modal_maps, only: legendre_of_nodes, sections_type
  use viscovib_phases, only: split_phase
  use viscovib_pole_maps, only: pole_gain, pole_wave
  use viscovib_section_step, only: driven_section, free_section, grown, section_wave
  use viscovib_structure_step, only: part_type
  implicit none
  private

  public :: places_type

  !> Depth of bisection up to which matrices are kept, and their largest total size.
  integer, parameter :: most_halvings = 4, most_numbers = 2*10**6

  !> Matrix from all inputs to the values at the positions of a part: coordinates, then their
  !! velocities, a column each.
  type :: rows_type
    real(wp), allocatable :: by(:, :)
  end type rows_type

  type :: places_type
    real(wp), private :: h = -1.0_wp
    !> Observed coordinates, and positions in a part.
    integer, allocatable, private :: which(:)
    real(wp), allocatable, private :: points(:)
    integer, private :: n_numbers = 0
    type(rows_type), private :: parts(0:2**(most_halvings + 1) - 2)
  contains
    procedure :: look
  end type places_type

contains

  !> Coordinates and velocities at the positions of a part of a step. `known` is false if no matrix
  !! is kept for the part.
  subroutine look(self, part, sections, shown, shown_left, table, begin, width, points, which, u, &
                  v, known)
    class(places_type), intent(inout) :: self
    !> The whole step.
    type(part_type), intent(in) :: part
    type(sections_type), intent(in) :: sections
    !> By modes, as in `show_state`.
    real(wp), intent(in) :: shown(:, :)
    complex(wp), intent(in) :: shown_left(:, :)
    type(collocation_type), intent(in) :: table
    !> The part, in [0, 1], and positions in it.
    real(wp), intent(in) :: begin, width, points(:)
    integer, intent(in) :: which(:)
    !> Shape (size(points), size(which)).
    real(wp), intent(out) :: u(:, :), v(:, :)
    logical, intent(out) :: known
    real(wp) :: seen(2*size(u))
    integer :: level, slot, n_in

    known = .false.
    if (sections%others%n_at_once > 0) return
    level = nint(-log(width)/log(2.0_wp))
    if (level > most_halvings .or. abs(width*2.0_wp**level - 1.0_wp) > 0.0_wp) return
    slot = 2**level - 1 + nint(begin/width)
    if (abs(begin - width*(slot + 1 - 2**level)) > 0.0_wp) return
    if (.not. is_of(self, part%length, points, which)) call begin_anew(self, part, points, which)
    n_in = 2*(size(part%q) + size(part%z) + size(sections%frequencies)) + size(part%forces)
    if (.not. allocated(self%parts(slot)%by)) then
      if (self%n_numbers + n_in*size(seen) > most_numbers) return
      self%n_numbers = self%n_numbers + n_in*size(seen)
      allocate (self%parts(slot)%by(n_in, size(seen)), source=0.0_wp)
      call make_rows(self%parts(slot)%by, part, sections, shown, shown_left, table, &
                     (begin + width*points)*part%length, which)
    end if
    seen = matmul(all_of(part, sections, n_in), self%parts(slot)%by)
    u = reshape(seen(:size(u)), shape(u))
    v = reshape(seen(size(u) + 1:), shape(v))
    known = .true.
  end subroutine look

  pure logical function is_of(self, h, points, which)
    type(places_type), intent(in) :: self
    real(wp), intent(in) :: h, points(:)
    integer, intent(in) :: which(:)
    is_of = allocated(self%which)
    if (is_of) is_of = abs(self%h - h) <= 0.0_wp .and. size(self%which) == size(which) &
                       .and. size(self%points) == size(points)
    if (is_of) is_of = all(self%which == which) .and. all(abs(self%points - points) <= 0.0_wp)
  end function is_of

  pure subroutine begin_anew(self, part, points, which)
    type(places_type), intent(inout) :: self
    type(part_type), intent(in) :: part
    real(wp), intent(in) :: points(:)
    integer, intent(in) :: which(:)
    integer :: i
    self%h = part%length
    self%which = which
    self%points = points
    self%n_numbers = 0
    do i = 0, ubound(self%parts, 1)
      if (allocated(self%parts(i)%by)) deallocate (self%parts(i)%by)
    end do
  end subroutine begin_anew

  !> All inputs of the motion in a step: q, v, Re z, Im z, forces, sines and cosines.
  function all_of(part, sections, n) result(x)
    type(part_type), intent(in) :: part
    type(sections_type), intent(in) :: sections
    integer, intent(in) :: n
    real(wp) :: x(n)
    real(wp) :: high(size(sections%frequencies)), low(size(sections%frequencies))
    call split_phase(sections%frequencies, part%start, high, low)
    x = [part%q, part%v, real(part%z), aimag(part%z), part%forces, sin(high + low), &
         cos(high + low)]
  end function all_of

  subroutine make_rows(by, part, sections, shown, shown_left, table, times, which)
    !> Shape (n_in, 2 n_times n_which), 0 at first.
    real(wp), intent(inout) :: by(:, :)
    type(part_type), intent(in) :: part
    type(sections_type), intent(in) :: sections
    real(wp), intent(in) :: shown(:, :)
    complex(wp), intent(in) :: shown_left(:, :)
    type(collocation_type), intent(in) :: table
    !> From the start of the step.
    real(wp), intent(in) :: times(:)
    integer, intent(in) :: which(:)
    real(wp), allocatable :: of_q(:, :), of_v(:, :)
    complex(wp), allocatable :: of_z(:, :)
    integer :: c, i, j, n, n_poles, at_z, half

    n = size(part%q)
    n_poles = size(part%z)
    at_z = 2*n
    half = size(by, 2)/2
    allocate (of_q(size(by, 1), n), of_v(size(by, 1), n), of_z(size(by, 1), n_poles))
    do i = 1, size(times)
      call modes_at(of_q, of_v, part, sections, table, times(i))
      call poles_at(of_z, part, sections, table, times(i), at_z)
      do c = 1, size(which)
        j = (c - 1)*size(times) + i
        by(:, j) = matmul(of_q, shown(:, which(c)))
        by(:, half + j) = matmul(of_v, shown(:, which(c)))
        if (n_poles == 0) cycle
        by(:, j) = by(:, j) + real(matmul(of_z, shown_left(:, which(c))))
        by(:, half + j) = by(:, half + j) &
                          + real(matmul(of_z, shown_left(:, which(c))*sections%others%poles))
      end do
    end do
  end subroutine make_rows

  !> Rows of modes and their velocities at time `now` after the start, a column each.
  subroutine modes_at(of_q, of_v, part, sections, table, now)
    real(wp), intent(out) :: of_q(:, :), of_v(:, :)
    type(part_type), intent(in) :: part
    type(sections_type), intent(in) :: sections
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: now
    real(wp), dimension(part%s) :: by_order, rates, gain, rate_gain
    real(wp) :: orders(part%s, part%s), by_q(2), by_v(2)
    complex(wp) :: answer, velocity
    integer :: at_force, at_wave, k, l, m, n, n_waves

    n = size(part%q)
    n_waves = size(sections%frequencies)
    of_q = 0.0_wp
    of_v = 0.0_wp
    at_wave = size(of_q, 1) - 2*n_waves
    if (now > 0.0_wp) orders = legendre_of_nodes(table, now/part%length)
    do m = 1, n
      of_q(m, m) = 1.0_wp
      of_v(n + m, m) = 1.0_wp
      if (.not. now > 0.0_wp) cycle
      associate (square => sections%squares(m)*now**2, rate => sections%rates(m)*now)
        call free_section(square, rate, by_q, by_v)
        call driven_section(square, rate, by_order, rates)
        of_q(m, m) = of_q(m, m) + by_q(1)
        of_q(n + m, m) = now*by_v(1)
        of_v(m, m) = by_q(2)/now
        of_v(n + m, m) = of_v(n + m, m) + by_v(2)
        gain = now**2*matmul(by_order, orders)
        rate_gain = now*matmul(rates, orders)
        do l = 1, size(part%forces, 2)
          at_force = 2*(n + size(part%z)) + (l - 1)*part%s
          of_q(at_force + 1:at_force + part%s, m) = sections%pushed(m, l)*gain
          of_v(at_force + 1:at_force + part%s, m) = sections%pushed(m, l)*rate_gain
        end do
        do k = 1, n_waves
          if (.not. abs(sections%waves(m, k)) > 0.0_wp) cycle
          call section_wave(square, rate, sections%frequencies(k)*now, answer, velocity)
          answer = now**2*sections%waves(m, k)*answer
          velocity = now*sections%waves(m, k)*velocity
          of_q(at_wave + k, m) = real(answer)
          of_q(at_wave + n_waves + k, m) = aimag(answer)
          of_v(at_wave + k, m) = real(velocity)
          of_v(at_wave + n_waves + k, m) = aimag(velocity)
        end do
      end associate
    end do
  end subroutine modes_at

  !> The same for the poles without real modes.
  subroutine poles_at(of_z, part, sections, table, now, at_z)
    complex(wp), intent(out) :: of_z(:, :)
    type(part_type), intent(in) :: part
    type(sections_type), intent(in) :: sections
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: now
    !> Count of inputs before Re z.
    integer, intent(in) :: at_z
    complex(wp) :: gain(part%s), waved(2)
    real(wp) :: orders(part%s, part%s)
    integer :: at_force, at_wave, k, l, m, n, n_waves

    n = size(part%z)
    n_waves = size(sections%frequencies)
    of_z = (0.0_wp, 0.0_wp)
    at_wave = size(of_z, 1) - 2*n_waves
    if (n > 0 .and. now > 0.0_wp) orders = legendre_of_nodes(table, now/part%length)
    associate (poles => sections%others)
      do m = 1, n
        of_z(at_z + m, m) = (1.0_wp, 0.0_wp)
        if (now > 0.0_wp) of_z(at_z + m, m) = of_z(at_z + m, m) + grown(poles%poles(m)*now)
        of_z(at_z + n + m, m) = of_z(at_z + m, m)*(0.0_wp, 1.0_wp)
        if (.not. now > 0.0_wp) cycle
        call pole_gain(poles%poles(m), now, orders, gain)
        do l = 1, size(part%forces, 2)
          at_force = at_z + 2*n + (l - 1)*part%s
          of_z(at_force + 1:at_force + part%s, m) = poles%right(m, l)*gain
        end do
        do k = 1, n_waves
          waved = pole_wave(poles%poles(m), sections%frequencies(k), now, poles%sine(m, k), &
                            poles%cosine(m, k))
          of_z(at_wave + k, m) = waved(1)
          of_z(at_wave + n_waves + k, m) = waved(2)
        end do
      end do
    end associate
  end subroutine poles_at

end module viscovib_structure_places
