!> The force laws of a system that are no polynomials, in a harmonic balance: harmonics and their
!! derivatives.
!!
!! A smooth law is taken at the samples of the balance as long as these tell it: if the highest
!! harmonics that they know are not small, the law is integrated piece by piece, as one with kinks
!! and one with hysteresis always is.
module viscovib_cycle_terms
  use viscovib_constants, only: pi
  use viscovib_harmonic_set, only: harmonic_set_type
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
  use viscovib_polynomial, only: polynomial_type
  use viscovib_sample_tables, only: sample_tables
  implicit none
  private

  public :: cycle_term, cycles_of, find_blocks, find_parts, has_kinks, has_states, law_of

  !> Part that the highest harmonics of the samples may have: what is folded back onto the orders
  !! kept is at least as many times smaller again.
  real(wp), parameter :: well_known = 1.0e-7_wp

  type :: cycle_term
    !> Place of the law among those of the system.
    integer :: law = 0
    logical, private :: sampled = .false.
    type(law_program), allocatable, private :: signals(:)
    !> Cosines and sines of the highest harmonics at the samples, shape (n_samples, 4).
    real(wp), allocatable, private :: highest(:, :)
    !> Of the last motion: harmonics of the arguments and what rates make of them, shape (n_parts,
    !! n_arguments), and the arguments at the samples, (n_samples, n_arguments).
    real(wp), allocatable, private :: y(:, :), rates(:, :), scan(:, :)
    !> Derivatives at the last motion, once they are known: of the harmonics by those of each
    !! argument, shape (n_parts, n_parts, n_arguments), and by the frequency, (n_parts).
    logical, private :: known = .false.
    real(wp), allocatable :: blocks(:, :, :), by_nu(:)
    !> Energy lost in a period (J), of an element with hysteresis.
    real(wp) :: lost = 0.0_wp
  end type cycle_term

contains

  !> The laws of a system that are no polynomials.
  subroutine cycles_of(system, set, cycles)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    type(cycle_term), allocatable, intent(out) :: cycles(:)
    integer, allocatable :: places(:)
    integer :: i, none(0)

    allocate (places(0))
    select type (system)
    class is (polynomial_type)
      places = pack([(i, i=1, size(system%laws))], system%laws%degree == 0)
      allocate (cycles(size(places)))
      do i = 1, size(places)
        cycles(i)%law = places(i)
        associate (law => system%laws(places(i)))
          if (law%state == 0) call find_signals(law%program, none, cycles(i)%signals)
        end associate
        call take_highest(cycles(i), set)
      end do
    end select
    if (.not. allocated(cycles)) allocate (cycles(0))
  end subroutine cycles_of

  pure subroutine take_highest(one, set)
    type(cycle_term), intent(inout) :: one
    type(harmonic_set_type), intent(in) :: set
    integer :: i, n, order, period, s

    n = set%n_samples
    period = merge(2*n, n, set%half_wave)
    allocate (one%highest(n, 4))
    do i = 1, 2
      if (set%half_wave) then
        order = 2*((n - 1)/2) + 1 - 2*i
      else
        order = (n - 1)/2 + 1 - i
      end if
      one%highest(:, 2*i - 1) = [(cos(2.0_wp*pi*modulo(order*s, period)/period), s=0, n - 1)]/n
      one%highest(:, 2*i) = [(sin(2.0_wp*pi*modulo(order*s, period)/period), s=0, n - 1)]/n
    end do
  end subroutine take_highest

  pure logical function has_states(system)
    class(oscillator_type), intent(in) :: system
    has_states = .false.
    select type (system)
    class is (polynomial_type)
      has_states = any(system%laws%state > 0)
    end select
  end function has_states

  !> Whether some law has kinks or jumps, so that harmonics fall off as powers of their order.
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

  !> Harmonics of the variables from these laws.
  subroutine find_parts(cycles, system, set, tables, mu, x, u, parts)
    type(cycle_term), intent(inout) :: cycles(:)
    class(oscillator_type), intent(in) :: system
    type(harmonic_set_type), intent(in) :: set
    type(sample_tables), intent(in) :: tables
    !> Frequencies of the orders (n_orders), harmonics (n_parts, n_dof), and samples of coordinates
    !! and rates read.
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
      call take_motion(cycles(i), law, mu, x)
      if (law%state > 0) then
        call run_element(cycles(i), law, set, own)
      else
        cycles(i)%scan = matmul(u(:set%n_samples, :), transpose(law%seen))
        call take_samples(cycles(i), law, tables, own)
        if (.not. cycles(i)%sampled) call law_parts(law%program, cycles(i)%signals, set, &
                                                    cycles(i)%y, cycles(i)%scan, own)
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

  !> Harmonics from the samples, if these know the law well enough.
  subroutine take_samples(one, law, tables, parts)
    type(cycle_term), intent(inout) :: one
    type(law_term), intent(in) :: law
    type(sample_tables), intent(in) :: tables
    real(wp), intent(out) :: parts(:)
    real(wp) :: value(tables%n_samples)
    integer :: n

    one%sampled = size(one%signals) == 0
    if (.not. one%sampled) return
    n = size(one%scan, 1)
    value(n + 1:) = 0.0_wp
    call law%program%evaluate(one%scan, value(:n))
    one%sampled = maxval(abs(matmul(value(:n), one%highest))) <= well_known*maxval(abs(value(:n)))
    if (one%sampled) call tables%to_parts(value, parts)
  end subroutine take_samples

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
      call slopes_at_samples(one, law, set, tables, one%blocks, one%by_nu)
      one%by_nu = one%by_nu/nu
      return
    end if
    call law_slopes(law%program, one%signals, set, one%y, one%rates, one%scan, sums)
    do m = 1, size(one%y, 2)
      call add_sandwich_of(set, sums%c(:, m), sums%s(:, m), 1.0_wp, one%blocks(:, :, m))
    end do
    if (allocated(sums%jumps)) one%blocks = one%blocks + sums%jumps
    one%by_nu = sums%along/nu
  end subroutine find_blocks

  subroutine slopes_at_samples(one, law, set, tables, blocks, by_nu)
    type(cycle_term), intent(in) :: one
    type(law_term), intent(in) :: law
    type(harmonic_set_type), intent(in) :: set
    type(sample_tables), intent(in) :: tables
    real(wp), intent(inout) :: blocks(:, :, :)
    real(wp), intent(out) :: by_nu(:)
    real(wp), dimension(tables%n_samples) :: value, padded, moved, rate
    real(wp) :: slopes(size(one%scan, 1), size(one%scan, 2))
    real(wp) :: c(-tables%reach:tables%reach), s(-tables%reach:tables%reach)
    integer :: m, n

    n = size(one%scan, 1)
    call law%program%differentiate(one%scan, value(:n), slopes)
    padded = 0.0_wp
    moved = 0.0_wp
    do m = 1, size(slopes, 2)
      padded(:n) = slopes(:, m)
      call tables%moments(padded, c, s)
      call add_sandwich_of(set, c, s, 1.0_wp, blocks(:, :, m))
      if (.not. any(abs(law%rates(m, :)) > 0.0_wp)) cycle
      call tables%to_samples(one%rates(:, m), rate)
      moved = moved + padded*rate
    end do
    call tables%to_parts(moved, by_nu)
  end subroutine slopes_at_samples

end module viscovib_cycle_terms
