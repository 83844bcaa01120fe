! Optimize: -O3 -fstack-arrays
!> The motion of a structure inside a step, exact like its maps at the end of the step.
!!
!! The observed coordinates at a position of a step are linear in the state at its start, in the
!! forces at its nodes, and in the sines and cosines of the load phases at its start. The
!! coefficients of a position are computed once for each step length, since the same positions are
!! needed in all steps.
module viscovib_structure_inside
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_kinds, only: wp
  use viscovib_modal_maps, only: sections_type
  use viscovib_phases, only: split_phase
  use viscovib_pole_maps, only: pole_gain, pole_rates, pole_wave, seen_of_poles, slopes_of_nodes, &
    wave_at_once
  use viscovib_quadrature, only: legendre_of_nodes
  use viscovib_section_step, only: driven_section, free_section, grown, section_wave
  use viscovib_structure_kernels, only: mode_block, seen_of
  use viscovib_structure_step, only: part_type
  implicit none
  private

  public :: places_type

  !> Largest number of positions of which coefficients are kept, and of their numbers.
  integer, parameter :: most_places = 512, most_numbers = 2*10**6

  !> Coefficients of a position.
  type :: place_type
    !> Changes of modes and of their velocities by both, shape (n), and of z.
    real(wp), allocatable :: q_by_q(:), q_by_v(:), v_by_q(:), v_by_v(:)
    complex(wp), allocatable :: by_z(:)
    !> Observed coordinates and then their velocities, a column each, by forces at the nodes and by
    !! sines, then cosines, of the loads, shape (s n_pushed + 2 n_waves, 2 n_shown).
    real(wp), allocatable :: by_input(:, :)
  end type place_type

  type :: places_type
    !> Step length; positions as times after the start of a step.
    real(wp), private :: h = -1.0_wp, ahead(most_places) = 0.0_wp
    integer, private :: n = 0, last = 0
    type(place_type), allocatable, private :: kept(:)
  contains
    procedure :: look
    procedure, private :: find
  end type places_type

contains

  !> Observed coordinates and their velocities at the time `ahead` after the start of a part of a
  !! step. The coefficients are kept if the part is a whole step.
  subroutine look(self, part, sections, shown, shown_left, usual, ahead, whole, which, u, v)
    class(places_type), intent(inout) :: self
    type(part_type), intent(in) :: part
    type(sections_type), intent(in) :: sections
    !> By modes, as in `show_state`.
    real(wp), intent(in), contiguous :: shown(:, :)
    complex(wp), intent(in), contiguous :: shown_left(:, :)
    !> Table of ordinary steps; parts of a first step have their own table.
    type(collocation_type), intent(in) :: usual
    real(wp), intent(in) :: ahead
    logical, intent(in) :: whole
    !> Indices of the coordinates.
    integer, intent(in) :: which(:)
    real(wp), intent(out) :: u(:), v(:)
    type(place_type) :: other
    type(collocation_type) :: table

    if (whole .and. part%s == usual%s) then
      if (self%find(part, sections, shown, shown_left, usual, ahead)) then
        call show(self%kept(self%last), part, sections, shown, shown_left, which, u, v)
        return
      end if
    end if
    if (part%s == usual%s) then
      call new_place(other, part, sections, shown, shown_left, usual, ahead)
    else
      call new_collocation(table, part%s)
      call new_place(other, part, sections, shown, shown_left, table, ahead)
    end if
    call show(other, part, sections, shown, shown_left, which, u, v)
  end subroutine look

  !> True if the coefficients of a position are kept, with the index `last`.
  logical function find(self, part, sections, shown, shown_left, table, ahead)
    class(places_type), intent(inout) :: self
    type(part_type), intent(in) :: part
    type(sections_type), intent(in) :: sections
    real(wp), intent(in), contiguous :: shown(:, :)
    complex(wp), intent(in), contiguous :: shown_left(:, :)
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: ahead
    integer :: i, k, most

    find = .true.
    if (.not. abs(self%h - part%length) <= 0.0_wp) then
      self%h = part%length
      self%n = 0
      self%last = 0
      if (.not. allocated(self%kept)) allocate (self%kept(most_places))
    end if
    ! Positions follow each other in the same order in each step.
    do i = 1, self%n
      k = self%last + i
      if (k > self%n) k = k - self%n
      if (abs(self%ahead(k) - ahead) <= 0.0_wp) then
        self%last = k
        return
      end if
    end do
    most = most_numbers/max(1, 4*size(part%q) + 2*size(part%z) + 2*size(shown, 2) &
                            *(size(part%forces) + 2*size(sections%frequencies)))
    find = self%n < min(most_places, most)
    if (.not. find) return
    self%n = self%n + 1
    self%last = self%n
    self%ahead(self%n) = ahead
    call new_place(self%kept(self%n), part, sections, shown, shown_left, table, ahead)
  end function find

  !> Apply coefficients to the motion of a step.
  subroutine show(place, part, sections, shown, shown_left, which, u, v)
    type(place_type), intent(in) :: place
    type(part_type), intent(in) :: part
    type(sections_type), intent(in) :: sections
    real(wp), intent(in), contiguous :: shown(:, :)
    complex(wp), intent(in), contiguous :: shown_left(:, :)
    integer, intent(in) :: which(:)
    real(wp), intent(out) :: u(:), v(:)
    real(wp), dimension(size(part%q)) :: q, w
    real(wp) :: input(size(place%by_input, 1))
    real(wp), dimension(size(sections%frequencies)) :: high, low
    complex(wp) :: z(size(part%z))
    integer :: c, d, n, n_blocks

    n = size(part%forces)
    n_blocks = size(q)/mode_block
    call split_phase(sections%frequencies, part%start, high, low)
    do c = 1, size(part%forces, 2)
      input((c - 1)*part%s + 1:c*part%s) = part%forces(:, c)
    end do
    input(n + 1:n + size(high)) = sin(high + low)
    input(n + size(high) + 1:) = cos(high + low)
    q = part%q + (place%q_by_q*part%q + place%q_by_v*part%v)
    w = part%v + (place%v_by_q*part%q + place%v_by_v*part%v)
    z = part%z + place%by_z*part%z
    do c = 1, size(which)
      d = which(c)
      u(c) = seen_of(n_blocks, shown(:, d), q) + dot_product(place%by_input(:, d), input)
      v(c) = seen_of(n_blocks, shown(:, d), w) &
             + dot_product(place%by_input(:, size(shown, 2) + d), input)
      if (size(z) == 0) cycle
      u(c) = u(c) + seen_of_poles(shown_left(:, d), z)
      v(c) = v(c) + pole_rates(shown_left(:, d), sections%others%poles, z)
    end do
  end subroutine show

  !> Coefficients of a position.
  subroutine new_place(place, part, sections, shown, shown_left, table, now)
    type(place_type), intent(inout) :: place
    type(part_type), intent(in) :: part
    type(sections_type), intent(in) :: sections
    real(wp), intent(in) :: shown(:, :)
    complex(wp), intent(in) :: shown_left(:, :)
    type(collocation_type), intent(in) :: table
    !> Time after the start of the part.
    real(wp), intent(in) :: now
    real(wp), dimension(size(part%forces) + 2*size(sections%frequencies)) :: by_input, by_rate
    real(wp) :: orders(part%s, part%s), by_q(2), by_v(2), slopes(part%s)
    real(wp), dimension(part%s) :: by_order, rates
    complex(wp), dimension(size(by_input)) :: by_pole
    complex(wp) :: gain(part%s), waves(2, size(sections%frequencies))
    integer :: d, k, m, n, n_poles, n_shown

    n = size(part%q)
    n_poles = size(part%z)
    n_shown = size(shown, 2)
    if (allocated(place%by_input)) deallocate (place%q_by_q, place%q_by_v, place%v_by_q, &
                                               place%v_by_v, place%by_z, place%by_input)
    allocate (place%q_by_q(n), place%q_by_v(n), place%v_by_q(n), place%v_by_v(n), source=0.0_wp)
    allocate (place%by_z(n_poles), source=(0.0_wp, 0.0_wp))
    allocate (place%by_input(size(by_input), 2*n_shown), source=0.0_wp)
    associate (poles => sections%others, rows => place%by_input)
      if (n_poles > 0 .or. now > 0.0_wp) then
        orders = legendre_of_nodes(table%points(1:table%s), table%b, now/part%length)
      end if
      do m = 1, n
        if (.not. now > 0.0_wp) exit
        associate (square => sections%squares(m)*now**2, rate => sections%rates(m)*now)
          call free_section(square, rate, by_q, by_v)
          call driven_section(square, rate, by_order, rates)
          do k = 1, size(waves, 2)
            waves(:, k) = (0.0_wp, 0.0_wp)
            if (.not. abs(sections%waves(m, k)) > 0.0_wp) cycle
            call section_wave(square, rate, sections%frequencies(k)*now, waves(1, k), waves(2, k))
            waves(:, k) = [now**2, now]*sections%waves(m, k)*waves(:, k)
          end do
        end associate
        place%q_by_q(m) = by_q(1)
        place%q_by_v(m) = now*by_v(1)
        place%v_by_q(m) = by_q(2)/now
        place%v_by_v(m) = by_v(2)
        by_input = inputs(sections%pushed(m, :), now**2*matmul(by_order, orders), waves(1, :))
        by_rate = inputs(sections%pushed(m, :), now*matmul(rates, orders), waves(2, :))
        do d = 1, n_shown
          if (.not. abs(shown(m, d)) > 0.0_wp) cycle
          rows(:, d) = rows(:, d) + shown(m, d)*by_input
          rows(:, n_shown + d) = rows(:, n_shown + d) + shown(m, d)*by_rate
        end do
      end do
      if (poles%n_at_once > 0) slopes = slopes_of_nodes(table, now/part%length)/part%length
      do m = 1, n_poles
        by_rate = 0.0_wp
        if (m > n_poles - poles%n_at_once) then
          place%by_z(m) = (-1.0_wp, 0.0_wp)
          gain = sum(orders, 1)
          do k = 1, size(waves, 2)
            associate (nu => sections%frequencies(k))
              waves(:, k) = nu*wave_at_once(nu*now, -poles%cosine(m, k), poles%sine(m, k))
              by_rate(size(part%forces) + k) = real(waves(1, k))
              by_rate(size(part%forces) + size(waves, 2) + k) = real(waves(2, k))
              waves(:, k) = wave_at_once(nu*now, poles%sine(m, k), poles%cosine(m, k))
            end associate
          end do
          by_rate(:size(part%forces)) = products(real(poles%right(m, :)), slopes)
        else
          if (.not. now > 0.0_wp) cycle
          place%by_z(m) = grown(poles%poles(m)*now)
          call pole_gain(poles%poles(m), now, orders, gain)
          do k = 1, size(waves, 2)
            waves(:, k) = pole_wave(poles%poles(m), sections%frequencies(k), now, &
                                    poles%sine(m, k), poles%cosine(m, k))
          end do
        end if
        do k = 1, size(poles%right, 2)
          by_pole((k - 1)*part%s + 1:k*part%s) = poles%right(m, k)*gain
        end do
        by_pole(size(part%forces) + 1:) = [waves(1, :), waves(2, :)]
        do d = 1, n_shown
          rows(:, d) = rows(:, d) + real(shown_left(m, d)*by_pole)
          rows(:, n_shown + d) = rows(:, n_shown + d) &
                                 + real(shown_left(m, d)*poles%poles(m)*by_pole) &
                                 + real(shown_left(m, d))*by_rate
        end do
      end do
    end associate
  end subroutine new_place

  !> Products of all pushes with all gains, then the coefficients of sines and of cosines in
  !! Im(wave exp(i phi)).
  pure function inputs(pushed, gain, waves)
    real(wp), intent(in) :: pushed(:), gain(:)
    complex(wp), intent(in) :: waves(:)
    real(wp) :: inputs(size(pushed)*size(gain) + 2*size(waves))
    inputs = [products(pushed, gain), real(waves), aimag(waves)]
  end function inputs

  pure function products(pushed, gain)
    real(wp), intent(in) :: pushed(:), gain(:)
    real(wp) :: products(size(pushed)*size(gain))
    integer :: l
    do l = 1, size(pushed)
      products((l - 1)*size(gain) + 1:l*size(gain)) = pushed(l)*gain
    end do
  end function products

end module viscovib_structure_inside
