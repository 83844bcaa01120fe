! Optimize: -O3
!> Force laws that are not polynomials in a harmonic balance: harmonics and their derivatives.
!!
!! A smooth law is evaluated at samples that resolve it: the samples of the balance or, if the
!! highest harmonics of the samples are not small, twice as many, and so on. If the largest table
!! does not resolve the law, it is integrated piecewise. Laws with kinks or hysteresis are always
!! integrated piecewise.
module viscovib_cycle_terms
  use viscovib_constants, only: pi
  use viscovib_harmonic_set, only: harmonic_set_type, new_harmonic_set, samples_of_laws
  use viscovib_hysteresis, only: hysteresis_type
  use viscovib_hysteresis_catalogue, only: new_hysteresis
  use viscovib_hysteresis_cycle, only: cycle_sums, run_cycle
  use viscovib_kinds, only: wp
  use viscovib_law_branches, only: find_signals
  use viscovib_law_cycle, only: law_parts, law_slopes, law_sums
  use viscovib_law_program, only: law_program
  use viscovib_law_term, only: law_term
  use viscovib_moment_block, only: add_sandwich_of
  use viscovib_oscillator, only: oscillator_type
  use viscovib_phase_roots, only: phase_list
  use viscovib_polynomial, only: polynomial_type
  use viscovib_sample_tables, only: new_sample_tables, sample_tables
  implicit none
  private

  public :: cycle_term, cycles_of, find_blocks, find_parts, has_kinks, has_states, law_of, &
            most_samples

  !> Largest relative size of the highest harmonics of the samples. The aliasing error of the
  !! included harmonics is smaller by at least the same factor.
  real(wp), parameter :: well_known = 1.0e-7_wp
  !> If the highest harmonics are smaller, half as many samples suffice (geometric decay).
  real(wp), parameter :: too_well_known = 1.0e-13_wp
  !> Number of sample levels, each with twice the previous number, and the largest table of a level.
  integer, parameter :: most_levels = 5, largest_table = 2**17

  !> Samples of a law: the samples of the balance, or more.
  type :: sample_level
    integer :: n = 0
    !> Cosines and sines of the highest harmonics at the samples, shape (n, 4).
    real(wp), allocatable :: highest(:, :)
    !> The arguments at the samples of the last motion, shape (n, n_arguments).
    real(wp), allocatable :: scan(:, :)
  end type sample_level

  type :: cycle_term
    !> Index of the law among the laws of the system.
    integer :: law = 0
    logical, private :: sampled = .false.
    type(law_program), allocatable, private :: signals(:)
    !> The parameters of the law for these signals: they change along a curve over one of them.
    real(wp), allocatable, private :: numbers(:)
    !> Level of the last samples, and the level to begin with at the next motion.
    integer, private :: level = 1, next_level = 1
    type(sample_level), allocatable, private :: levels(:)
    !> Tables of the levels beyond the first.
    type(sample_tables), allocatable, private :: tables(:)
    !> Of the last motion: harmonics of the arguments, and the contribution of the rates to them,
    !! shape (n_parts, n_arguments).
    real(wp), allocatable, private :: y(:, :), rates(:, :)
    !> Phases at which the law switches, if it is integrated piecewise.
    type(phase_list), private :: switches
    !> Derivatives at the last motion, once computed (`known`): of the harmonics by those of each
    !! argument, shape (n_parts, n_parts, n_arguments), and by the frequency, (n_parts).
    logical, private :: known = .false.
    real(wp), allocatable :: blocks(:, :, :), by_nu(:)
    !> Energy lost per period (J), for an element with hysteresis.
    real(wp) :: lost = 0.0_wp
  end type cycle_term

contains

  !> The laws of a system that are not polynomials.
  subroutine cycles_of(system, set, cycles)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    type(cycle_term), allocatable, intent(out) :: cycles(:)
    integer, allocatable :: places(:)
    integer :: i

    allocate (places(0))
    select type (system)
    class is (polynomial_type)
      places = pack([(i, i=1, size(system%laws))], system%laws%degree == 0)
      allocate (cycles(size(places)))
      do i = 1, size(places)
        cycles(i)%law = places(i)
        call renew_signals(cycles(i), system%laws(places(i)))
        allocate (cycles(i)%levels(most_levels), cycles(i)%tables(most_levels))
        cycles(i)%levels(1)%n = set%n_samples
      end do
    end select
    if (.not. allocated(cycles)) allocate (cycles(0))
  end subroutine cycles_of

  !> Find the switching functions of a law again if its parameters have changed.
  subroutine renew_signals(one, law)
    type(cycle_term), intent(inout) :: one
    type(law_term), intent(in) :: law
    integer :: none(0)

    if (law%state > 0) return
    if (allocated(one%numbers)) then
      if (size(one%numbers) == size(law%program%number)) then
        if (.not. any(abs(one%numbers - law%program%number) > 0.0_wp)) return
      end if
    end if
    one%numbers = law%program%number
    call find_signals(law%program, none, one%signals)
  end subroutine renew_signals

  !> Prepare a level: its tables, and the highest harmonics at its samples.
  subroutine prepare_level(level, tables, at, set)
    type(sample_level), intent(inout) :: level
    type(sample_tables), intent(inout) :: tables
    integer, intent(in) :: at
    type(harmonic_set_type), intent(in) :: set
    type(harmonic_set_type) :: finer
    real(wp) :: angle
    integer :: i, n, order, period, s

    if (allocated(level%highest)) return
    if (at > 1) then
      call new_harmonic_set(finer, maxval(set%orders), set%half_wave, &
                            samples_of_laws*2**(at - 1) - 1)
      call new_sample_tables(tables, finer)
      level%n = finer%n_samples
    end if
    n = level%n
    period = merge(2*n, n, set%half_wave)
    allocate (level%highest(n, 4))
    do i = 1, 2
      if (set%half_wave) then
        order = 2*((n - 1)/2) + 1 - 2*i
      else
        order = (n - 1)/2 + 1 - i
      end if
      do s = 0, n - 1
        angle = 2.0_wp*pi*modulo(order*s, period)/period
        level%highest(s + 1, 2*i - 1) = cos(angle)/n
        level%highest(s + 1, 2*i) = sin(angle)/n
      end do
    end do
  end subroutine prepare_level

  pure logical function has_states(system)
    class(oscillator_type), intent(in) :: system
    has_states = .false.
    select type (system)
    class is (polynomial_type)
      has_states = any(system%laws%state > 0)
    end select
  end function has_states

  !> True if a law has kinks or jumps, so that harmonics decay as powers of their order.
  logical function has_kinks(system)
    class(oscillator_type), intent(in) :: system
    integer :: i
    has_kinks = .false.
    select type (system)
    class is (polynomial_type)
      has_kinks = any(system%laws%state > 0)
      do i = 1, size(system%laws)
        if (.not. has_kinks) has_kinks = system%laws(i)%program%n_surfaces() > 0
      end do
    end select
  end function has_kinks

  !> Largest number of samples per period of the laws at the last motion; 0: none was sampled.
  pure integer function most_samples(cycles, half_wave)
    type(cycle_term), intent(in) :: cycles(:)
    logical, intent(in) :: half_wave
    integer :: i
    most_samples = 0
    do i = 1, size(cycles)
      if (cycles(i)%sampled) most_samples = max(most_samples, cycles(i)%levels(cycles(i)%level)%n)
    end do
    if (half_wave) most_samples = 2*most_samples
  end function most_samples

  !> The law of a term.
  function law_of(one, system) result(law)
    type(cycle_term), intent(in) :: one
    class(oscillator_type), intent(in), target :: system
    type(law_term), pointer :: law
    law => null()
    select type (system)
    class is (polynomial_type)
      law => system%laws(one%law)
    end select
  end function law_of

  !> Harmonics of the variables due to these laws.
  subroutine find_parts(cycles, system, set, tables, mu, x, u, parts)
    type(cycle_term), intent(inout) :: cycles(:)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    type(sample_tables), intent(in) :: tables
    !> Frequencies of the orders (n_orders), harmonics (n_parts, n_dof), and samples of coordinates
    !! and rates.
    real(wp), intent(in) :: mu(:), x(:, :), u(:, :)
    !> Shape (n_parts, n_memory).
    real(wp), intent(out) :: parts(:, :)
    type(law_term), pointer :: law
    real(wp) :: own(size(x, 1))
    integer :: i, j

    parts = 0.0_wp
    do i = 1, size(cycles)
      law => law_of(cycles(i), system)
      cycles(i)%known = .false.
      call renew_signals(cycles(i), law)
      call take_motion(cycles(i), law, mu, x)
      if (law%state > 0) then
        call run_element(cycles(i), law, set, own)
      else
        cycles(i)%levels(1)%scan = matmul(u(:set%n_samples, :), transpose(law%seen))
        call take_samples(cycles(i), law, set, tables, own)
        if (.not. cycles(i)%sampled) call law_parts(law%program, cycles(i)%signals, set, &
                                                    cycles(i)%y, cycles(i)%levels(1)%scan, own, &
                                                    cycles(i)%switches)
      end if
      do j = 1, size(law%variables)
        parts(:, law%variables(j)) = parts(:, law%variables(j)) + law%weights(j)*own
      end do
    end do
  end subroutine find_parts

  !> Harmonics of the arguments.
  pure subroutine take_motion(one, law, mu, x)
    type(cycle_term), intent(inout) :: one
    type(law_term), intent(in) :: law
    real(wp), intent(in) :: mu(:), x(:, :)
    real(wp) :: turned(size(x, 1), size(law%rates, 1))

    turned = matmul(x, transpose(law%rates))
    one%rates = turned
    one%rates(1::2, :) = -spread(mu, 2, size(turned, 2))*turned(2::2, :)
    one%rates(2::2, :) = spread(mu, 2, size(turned, 2))*turned(1::2, :)
    one%y = matmul(x, transpose(law%arguments)) + one%rates
  end subroutine take_motion

  subroutine run_element(one, law, set, parts, sums)
    type(cycle_term), intent(inout) :: one
    type(law_term), intent(in) :: law
    type(harmonic_set_type), intent(in) :: set
    real(wp), intent(out) :: parts(:)
    type(cycle_sums), intent(inout), optional :: sums
    class(hysteresis_type), allocatable :: element
    real(wp), allocatable :: multiplier(:)
    call new_hysteresis(element, law%state, law%program%number(2:))
    allocate (multiplier(element%n_states()))
    call run_cycle(element, set, one%y(:, 1), parts, one%lost, multiplier, sums)
  end subroutine run_element

  !> Harmonics from samples, if a level resolves the law.
  subroutine take_samples(one, law, set, tables, parts)
    type(cycle_term), intent(inout) :: one
    type(law_term), intent(in) :: law
    type(harmonic_set_type), intent(in) :: set
    type(sample_tables), intent(in) :: tables
    real(wp), intent(out) :: parts(:)
    real(wp) :: size_of, left
    integer :: at

    one%sampled = .false.
    if (size(one%signals) > 0) return
    do at = one%next_level, most_levels
      if (at > 1 .and. samples_of_laws*2**(at - 1)*maxval(set%orders)*size(parts) &
          > largest_table) exit
      call prepare_level(one%levels(at), one%tables(at), at, set)
      if (at == 1) then
        call sample_at(law, tables, one%levels(at), size_of, left, parts)
      else
        call scan_level(one%y, one%tables(at), one%levels(at))
        call sample_at(law, one%tables(at), one%levels(at), size_of, left, parts)
      end if
      one%level = at
      one%next_level = at
      one%sampled = left <= well_known*size_of
      if (.not. one%sampled) cycle
      if (left <= too_well_known*size_of) one%next_level = max(1, at - 1)
      return
    end do
  end subroutine take_samples

  !> The arguments at the samples of a level.
  subroutine scan_level(y, tables, level)
    !> Harmonics of the arguments, shape (n_parts, n_arguments).
    real(wp), intent(in) :: y(:, :)
    type(sample_tables), intent(in) :: tables
    type(sample_level), intent(inout) :: level
    real(wp) :: samples(tables%n_samples)
    integer :: m

    if (.not. allocated(level%scan)) allocate (level%scan(level%n, size(y, 2)))
    do m = 1, size(y, 2)
      call tables%to_samples(y(:, m), samples)
      level%scan(:, m) = samples(:level%n)
    end do
  end subroutine scan_level

  !> Harmonics from the samples of a level, if these resolve the law.
  subroutine sample_at(law, tables, level, size_of, left, parts)
    type(law_term), intent(in) :: law
    type(sample_tables), intent(in) :: tables
    type(sample_level), intent(in) :: level
    !> Largest value, and magnitude of the highest harmonics.
    real(wp), intent(out) :: size_of, left
    real(wp), intent(inout) :: parts(:)
    real(wp) :: value(tables%n_samples)
    integer :: i

    associate (n => level%n)
      value(n + 1:) = 0.0_wp
      call law%program%evaluate(level%scan, value(:n))
      size_of = maxval(abs(value(:n)))
      left = 0.0_wp
      do i = 1, 4
        left = max(left, abs(dot_product(value(:n), level%highest(:, i))))
      end do
    end associate
    if (left <= well_known*size_of) call tables%to_parts(value, parts)
  end subroutine sample_at

  !> Derivatives of the harmonics of one law at the last motion.
  subroutine find_blocks(one, system, set, tables, nu)
    type(cycle_term), intent(inout) :: one
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    type(sample_tables), intent(in) :: tables
    real(wp), intent(in) :: nu
    type(law_term), pointer :: law
    type(law_sums) :: sums
    type(cycle_sums) :: states
    real(wp) :: own(size(one%y, 1))
    integer :: m

    if (one%known) return
    one%known = .true.
    law => law_of(one, system)
    if (.not. allocated(one%blocks)) then
      allocate (one%blocks(size(own), size(own), size(one%y, 2)), one%by_nu(size(own)))
    end if
    one%blocks = 0.0_wp
    one%by_nu = 0.0_wp
    if (law%state > 0) then
      call run_element(one, law, set, own, states)
      call add_sandwich_of(set, states%c, states%s, 1.0_wp, one%blocks(:, :, 1))
      one%blocks(:, :, 1) = one%blocks(:, :, 1) + states%past
      return
    end if
    if (one%sampled) then
      associate (scan => one%levels(one%level)%scan)
        if (one%level == 1) then
          call slopes_at_samples(law, set, tables, one%rates, scan, one%blocks, one%by_nu)
        else
          call slopes_at_samples(law, set, one%tables(one%level), one%rates, scan, one%blocks, &
                                 one%by_nu)
        end if
      end associate
      one%by_nu = one%by_nu/nu
      return
    end if
    call law_slopes(law%program, one%signals, set, one%y, one%rates, &
                    one%levels(1)%scan, one%switches, sums)
    do m = 1, size(one%y, 2)
      call add_sandwich_of(set, sums%c(:, m), sums%s(:, m), 1.0_wp, one%blocks(:, :, m))
    end do
    if (allocated(sums%jumps)) one%blocks = one%blocks + sums%jumps
    one%by_nu = sums%along/nu
  end subroutine find_blocks

  subroutine slopes_at_samples(law, set, tables, rates, scan, blocks, by_nu)
    type(law_term), intent(in) :: law
    type(harmonic_set_type), intent(in) :: set
    type(sample_tables), intent(in) :: tables
    !> Contribution of the rates to the arguments' harmonics, and the arguments at the samples.
    real(wp), intent(in) :: rates(:, :), scan(:, :)
    real(wp), intent(inout) :: blocks(:, :, :)
    real(wp), intent(out) :: by_nu(:)
    real(wp), dimension(tables%n_samples) :: value, padded, moved, rate
    real(wp) :: slopes(size(scan, 1), size(scan, 2))
    real(wp) :: c(-tables%reach:tables%reach), s(-tables%reach:tables%reach)
    integer :: m, n

    n = size(scan, 1)
    call law%program%differentiate(scan, value(:n), slopes)
    padded = 0.0_wp
    moved = 0.0_wp
    do m = 1, size(slopes, 2)
      padded(:n) = slopes(:, m)
      call tables%moments(padded, c, s)
      call add_sandwich_of(set, c, s, 1.0_wp, blocks(:, :, m))
      if (.not. any(abs(law%rates(m, :)) > 0.0_wp)) cycle
      call tables%to_samples(rates(:, m), rate)
      moved = moved + padded*rate
    end do
    call tables%to_parts(moved, by_nu)
  end subroutine slopes_at_samples

end module viscovib_cycle_terms
